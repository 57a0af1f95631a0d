"""The results of a comparison as Markdown and JSON: medians over the rounds, with their range."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
from pathlib import Path
from typing import Any

#: Columns of a table of policies: key of the result, title, decimal digits.
_POLICY_COLUMNS = (
    ("steps_per_second", "steps/s", 0),
    ("trajectories_per_second", "trajectories/s", 2),
    ("reset_s", "reset, s", 2),
    ("chunk_ms_p50", "chunk p50, ms", 0),
    ("chunk_ms_p95", "chunk p95, ms", 0),
    ("products_per_second", "products/s", 1),
)
#: Columns of a table of processes: key of the result, title, decimal digits.
_PROCESS_COLUMNS = (
    ("construct_s", "construction, s", 1),
    ("pss_mib", "PSS per environment, MiB", 0),
    ("card_mib", "card, MiB", 0),
    ("cpu_s", "CPU, s", 0),
)


def machine() -> str:
    """Returns the processor, the number of cores and the accelerator."""
    cpu_lines = Path("/proc/cpuinfo").read_text().splitlines()
    models = [line.partition(": ")[2] for line in cpu_lines if line.startswith("model name")]
    name = models[0] if models else "unknown processor"
    words = [f"{len(os.sched_getaffinity(0))} × {name}"]
    try:
        command = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
        query = subprocess.run(command, capture_output=True, text=True, check=True)
        words += query.stdout.splitlines()
    except (OSError, subprocess.CalledProcessError):
        words.append("no accelerator")
    return ", ".join(filter(None, words))


def write(results: dict[str, Any], folder: Path) -> None:
    """Writes `results.json` and `results.md`."""
    (folder / "results.json").write_text(json.dumps(results, indent=1))
    (folder / "results.md").write_text(markdown(results))


def markdown(results: dict[str, Any]) -> str:
    """Returns the results of the checks, and the tables of all scenarios."""
    lines = [f"On {results['machine']}.", ""]
    for task, check in results["checks"].items():
        lines.append(
            f"- {task}: OpenGL of the original: {check['renderer']}; readings of the robot differ "
            f"by at most {check['apart_before_contact']:.1e} before the first contact (step "
            f"{check['first_contact']}); success at step {check['success_original']} in the "
            f"original, {check['success_shim']} in the shim"
        )
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for run in results["runs"]:
        key = (run["framework"], run["task"], run["environments"])
        groups.setdefault(key, []).append(run)
    for (framework, task, count), runs in groups.items():
        lines += ["", f"### {framework}, {task}, {count} environments", ""]
        lines += _policy_table(runs) + [""] + _process_table(runs)
    return "\n".join(lines) + "\n"


def _policy_table(runs: list[dict[str, Any]]) -> list[str]:
    succeeded = [run for run in runs if "error" not in run]
    names = list(dict.fromkeys(name for run in succeeded for name in run["policies"]))
    titles = [title for _, title, _ in _POLICY_COLUMNS]
    lines = _head(["policy", "arm", *titles, "steps/s relative to O", "to O'"])
    for name in names:
        speeds: dict[str, float] = {}
        for arm, arm_runs in _by_arm(succeeded).items():
            rows = [run["policies"][name] for run in arm_runs]
            speed = statistics.median(row["steps_per_second"] for row in rows)
            speeds[arm] = speed
            cells = [
                _cell([row.get(key) for row in rows], digits) for key, _, digits in _POLICY_COLUMNS
            ]
            ratios = [
                f"{speed / speeds[base]:.2f}" if base in speeds else "–" for base in ("O", "O'")
            ]
            lines.append("| " + " | ".join([name, arm, *cells, *ratios]) + " |")
    return lines


def _process_table(runs: list[dict[str, Any]]) -> list[str]:
    lines = _head(["arm", "rounds", *(title for _, title, _ in _PROCESS_COLUMNS)])
    for arm, arm_runs in _by_arm([run for run in runs if "error" not in run]).items():
        cells = [
            _cell([run.get(key) for run in arm_runs], digits) for key, _, digits in _PROCESS_COLUMNS
        ]
        lines.append("| " + " | ".join([arm, str(len(arm_runs)), *cells]) + " |")
    loops = sorted({run["loop"] for run in runs if "loop" in run})
    lines += ["", f"Run by {', '.join(loops)}."] if loops else []
    lines += [
        f"\n{run['arm']}, round {run['round']}, failed: {run['error'][-300:]}"
        for run in runs
        if "error" in run
    ]
    return lines


def _by_arm(runs: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    arms: dict[str, list[dict[str, Any]]] = {}
    for run in runs:
        arms.setdefault(run["arm"], []).append(run)
    return arms


def _head(titles: list[str]) -> list[str]:
    return ["| " + " | ".join(titles) + " |", "|" + " --- |" * len(titles)]


def _cell(values: list[float | None], digits: int) -> str:
    present = [value for value in values if value is not None]
    if not present:
        return "–"
    median = f"{statistics.median(present):,.{digits}f}"
    if len(present) == 1:
        return median
    return f"{median} ({min(present):,.{digits}f}–{max(present):,.{digits}f})"
