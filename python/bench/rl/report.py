"""The results of a comparison as Markdown and JSON: medians over the rounds, with their range."""

import json
import os
import statistics
import subprocess
from pathlib import Path
from typing import Any

#: Columns of the table: key of the result, title, decimal digits. The last two are of the process.
_COLUMNS = (
    ("steps_per_second", "steps/s", 0),
    ("trajectories_per_second", "trajectories/s", 2),
    ("reset_s", "reset, s", 2),
    ("products_per_second", "products/s", 1),
    ("pss_mib", "PSS per environment, MiB", 0),
    ("card_mib", "card, MiB", 0),
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
        lines += _table(runs)
    return "\n".join(lines) + "\n"


def _table(runs: list[dict[str, Any]]) -> list[str]:
    titles = ["policy", "arm", "rounds", *(title for _, title, _ in _COLUMNS)]
    lines = ["| " + " | ".join(titles) + " |", "|" + " --- |" * len(titles)]
    rows: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for run in runs:
        for name, result in run.get("policies", {}).items():
            rows.setdefault((name, run["arm"]), []).append({**run, **result})
    for key, measured in rows.items():
        cells = [_cell([row.get(name) for row in measured], digits) for name, _, digits in _COLUMNS]
        lines.append("| " + " | ".join([*key, str(len(measured)), *cells]) + " |")
    failed = [run for run in runs if "error" in run]
    return lines + [
        f"\n{run['arm']}, round {run['round']}, failed: {run['error'][-300:]}" for run in failed
    ]


def _cell(values: list[float | None], digits: int) -> str:
    present = [value for value in values if value is not None]
    if not present:
        return "–"
    median = f"{statistics.median(present):,.{digits}f}"
    if len(present) == 1:
        return median
    return f"{median} ({min(present):,.{digits}f}–{max(present):,.{digits}f})"
