"""Compares rollouts of reinforcement learning in the original LIBERO and in rollout-libero, each
simulator in turn, and prints a table in Markdown. Needs no network and no build.

    python compare.py --original FOLDERS --shim FOLDERS --out FOLDER

`FOLDERS` are entries of PYTHONPATH, separated by colons: those of `--original` hold robosuite 1.4.0
and rlinf-libero or hf-libero, those of `--shim` this project's wheels. RLinf and the packages that
both simulators need must be in both `FOLDERS`, or installed in Python's environment. The original
uses LIBERO_CONFIG_PATH, and rollout_libero uses ROLLOUT_SOURCES and ROLLOUT_ASSETS. Results are
written after every run, so that an interrupted comparison keeps the results of its complete runs.

Arms: O, the original, rendering through EGL. O', the original that renders only the last step of
a chunk. S, the shim with every frame read. S+, the shim with only the last frames of chunks read:
it renders only frames that are read. V, all environments in one process: in RLinf by
`rollout_libero.rlinf`, which users name in RLINF_EXT_MODULE; otherwise by a TrainingEnvironment in
place of SimpleVLA-RL's processes. RLinf reads every frame, so its S+ equals S.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import checks
import report
from rollouts import SETTLING
from stand_ins import LAST_OF_CHUNK

HERE = Path(__file__).resolve().parent
ARMS = {"rlinf": ("O", "O'", "S", "V"), "simplevla": ("O", "O'", "S", "S+", "V")}
#: Largest number of environments of a framework: RLinf starts each in a different one of a task's
#: 50 states, and SimpleVLA-RL runs few at a time.
MAX_ENVIRONMENTS = {"rlinf": 50, "simplevla": 16}


def main() -> int:
    """Runs the command line."""
    flags = arguments()
    flags.out.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + 60 * flags.minutes
    results: dict[str, Any] = {"machine": report.machine(), "command": sys.argv[1:], "runs": []}
    results["checks"] = fairness(flags) if flags.checks else {}
    report.write(results, flags.out)
    longest: dict[Any, float] = {}
    for round_number, (framework, count), task in itertools.product(
        range(1, flags.rounds + 1), sizes(flags.environments, flags.frameworks), flags.tasks
    ):
        scenario = {"framework": framework, "task": task, "environments": count}
        arms = [arm for arm in ARMS[framework] if arm in flags.arms]
        keys = {arm: (framework, task, count, arm) for arm in arms}
        # A round has all of its arms or none, so that all are measured under the same conditions.
        # The factor 1.1 leaves a margin over the longest durations so far.
        if end - time.monotonic() < 1.1 * sum(longest.get(key, 0.0) for key in keys.values()):
            print(f"{scenario}, round {round_number}: skipped for lack of time", flush=True)
            continue
        for arm, key in keys.items():
            start = time.monotonic()
            measured = measure(flags, framework, arm, task, count, end - start)
            longest[key] = max(longest.get(key, 0.0), time.monotonic() - start)
            results["runs"].append({**scenario, "arm": arm, "round": round_number, **measured})
            print(f"{key}, round {round_number}: {json.dumps(measured)}", flush=True)
            report.write(results, flags.out)
    print(report.markdown(results))
    fair = all(task["same_motion"] and task["same_success"] for task in results["checks"].values())
    return 0 if fair else 1


def sizes(environments: list[int], frameworks: list[str]) -> list[tuple[str, int]]:
    """Returns each framework with each number of environments that it runs, once."""
    pairs = itertools.product(environments, frameworks)
    return list(dict.fromkeys((name, min(size, MAX_ENVIRONMENTS[name])) for size, name in pairs))


def arguments() -> argparse.Namespace:
    """Parses the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--original", default="", help="the original's entries of PYTHONPATH")
    parser.add_argument("--shim", default="", help="this project's entries of PYTHONPATH")
    parser.add_argument("--original-python", default=sys.executable)
    parser.add_argument("--shim-python", default=sys.executable)
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--frameworks", nargs="+", default=list(ARMS), choices=list(ARMS))
    parser.add_argument("--arms", nargs="+", default=["O", "O'", "S", "S+", "V"])
    parser.add_argument("--tasks", nargs="+", default=["libero_goal/8"])
    parser.add_argument(
        "--environments",
        nargs="+",
        type=int,
        default=[16, 50],
        help="numbers of environments; at most 50 run in RLinf, and 16 in SimpleVLA-RL",
    )
    parser.add_argument("--chunk", type=int, default=8)
    parser.add_argument("--steps", type=int, default=200, help="control steps of a rollout")
    parser.add_argument(
        "--policies",
        nargs="+",
        default=["none", "sleep:100"],
        help="none or sleep:MS; with PyTorch and an accelerator also card:MS or busy",
    )
    parser.add_argument(
        "--shared-reset",
        action="store_true",
        help="reset once per process: each policy continues the rollout of the previous policy, and"
        " the time of the reset counts for every policy",
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--minutes", type=float, default=24 * 60.0, help="largest duration")
    parser.add_argument("--no-checks", dest="checks", action="store_false")
    parser.add_argument("--gl", default="egl", help="MUJOCO_GL of the original")
    return parser.parse_args()


def fairness(flags: argparse.Namespace) -> dict[str, Any]:
    """Returns the verdict of the checks for each task."""
    verdicts = {}
    for task in flags.tasks:
        file = flags.out / f"actions-{task.replace('/', '-')}.npy"
        shim, original = environment(flags, "S"), environment(flags, "O")
        call([flags.shim_python, HERE / "checks.py", "record", task, file], shim, 300)
        ours = call([flags.shim_python, HERE / "checks.py", "replay", task, file], shim, 300)
        theirs = call(
            [flags.original_python, HERE / "checks.py", "replay", task, file], original, 300
        )
        verdicts[task] = checks.verdict(theirs, ours)
        print(f"checks of {task}: {json.dumps(verdicts[task])}", flush=True)
    return verdicts


def measure(
    flags: argparse.Namespace, framework: str, arm: str, task: str, count: int, limit_secs: float
) -> dict[str, Any]:
    """Runs one arm for at most `limit_secs`. Returns the measurements of `measure.py`, or an
    error."""
    python = flags.original_python if arm.startswith("O") else flags.shim_python
    command = [python, HERE / "measure.py", framework, arm, task]
    command += ["--environments", count, "--chunk", flags.chunk, "--steps", flags.steps]
    command += ["--policies", *flags.policies]
    command += ["--shared-reset"] if flags.shared_reset else []
    variables = environment(flags, arm)
    if arm == "O'":
        variables[LAST_OF_CHUNK] = f"{SETTLING[framework]}:{flags.chunk}"
    try:
        return call(command, variables, limit_secs)
    except RuntimeError as error:
        return {"error": str(error)}


def environment(flags: argparse.Namespace, arm: str) -> dict[str, str]:
    """Returns the environment variables of an arm."""
    original = arm.startswith("O")
    variables = {
        **os.environ,
        "PYTHONPATH": flags.original if original else flags.shim,
        "PYTHONWARNINGS": "ignore",
        # One thread for each environment, as users of the original set it.
        "OMP_NUM_THREADS": "1",
        "LP_NUM_THREADS": "1",
        "MUJOCO_GL": flags.gl,
        "PYOPENGL_PLATFORM": flags.gl,
    }
    if not original:
        # The shim must not write into the original's settings.
        variables["LIBERO_CONFIG_PATH"] = str(flags.out / "shim-settings")
    variables.pop("RLINF_EXT_MODULE", None)
    return variables


def call(command: list[Any], variables: dict[str, str], limit_secs: float) -> Any:
    """Runs a program in a new session; returns the JSON of its last line.

    Raises:
        RuntimeError: with the end of the program's messages, if it fails or exceeds the limit."""
    process = subprocess.Popen(
        [str(word) for word in command],
        env=variables,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        out, err = process.communicate(timeout=max(limit_secs, 1.0))
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        _, err = process.communicate()
        raise RuntimeError(f"stopped after {limit_secs:.0f} s: {err[-1500:]}") from None
    if process.returncode:
        raise RuntimeError(f"status {process.returncode}: {out[-500:]}{err[-2500:]}")
    return json.loads(out.splitlines()[-1])


if __name__ == "__main__":
    sys.exit(main())
