"""Compares rollouts of reinforcement learning in the original LIBERO and in rollout-libero, each
simulator in turn, and prints a table in Markdown. Needs no network and no build.

    python compare.py --original FOLDERS --shim FOLDERS --out FOLDER

`FOLDERS` are entries of PYTHONPATH, separated by colons: those of `--original` hold robosuite 1.4.0
and rlinf-libero or hf-libero, those of `--shim` this project's wheels. RLinf and the packages that
both simulators need must be in both `FOLDERS`, or installed in Python's environment. The original
uses LIBERO_CONFIG_PATH, and rollout_libero uses ROLLOUT_SOURCES and ROLLOUT_ASSETS. `results.json`
is written after every run, so that an interrupted comparison keeps the results of its complete
runs.

Arms: O, the original, rendering through EGL. S, the shim. V, all environments in one process: in
RLinf by `rollout_libero.rlinf`, which users name in RLINF_EXT_MODULE; otherwise by a
TrainingEnvironment in place of SimpleVLA-RL's processes."""

import argparse
import itertools
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

FRAMEWORKS, ARMS = ["rlinf", "simplevla"], ["O", "S", "V"]
#: Largest number of environments of a framework: RLinf starts each in a different one of a task's
#: 50 states, and SimpleVLA-RL runs few at a time.
MAX_ENVIRONMENTS = {"rlinf": 50, "simplevla": 16}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--original", default="", help="the original's entries of PYTHONPATH")
    parser.add_argument("--shim", default="", help="this project's entries of PYTHONPATH")
    parser.add_argument("--original-python", default=sys.executable)
    parser.add_argument("--shim-python", default=sys.executable)
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--frameworks", nargs="+", default=FRAMEWORKS, choices=FRAMEWORKS)
    parser.add_argument("--arms", nargs="+", default=ARMS, choices=ARMS)
    parser.add_argument("--task", default="libero_goal/8")
    parser.add_argument(
        "--environments", nargs="+", type=int, default=[16, 50],
        help="numbers of environments; at most 50 run in RLinf, and 16 in SimpleVLA-RL",
    )  # fmt: skip
    parser.add_argument("--chunk", type=int, default=8)
    parser.add_argument("--steps", type=int, default=200, help="control steps of a rollout")
    parser.add_argument(
        "--policies", nargs="+", default=["none"],
        help="none answers at once, card:MS multiplies matrices on the card for so long",
    )  # fmt: skip
    parser.add_argument("--rounds", type=int, default=3)
    flags = parser.parse_args()
    flags.out.mkdir(parents=True, exist_ok=True)
    sizes = dict.fromkeys(
        (framework, min(count, MAX_ENVIRONMENTS[framework]))
        for count, framework in itertools.product(flags.environments, flags.frameworks)
    )
    runs: dict[str, list[dict[str, float]]] = {}
    for _, (framework, count), arm in itertools.product(range(flags.rounds), sizes, flags.arms):
        for policy, measured in measure(flags, framework, arm, count).items():
            runs.setdefault(f"{framework} | {count} | {policy} | {arm}", []).append(measured)
        (flags.out / "results.json").write_text(json.dumps(runs, indent=1))
    for number, (scenario, rounds) in enumerate(runs.items()):
        if number == 0:
            titles = ["framework", "environments", "policy", "arm", *rounds[0]]
            print("| " + " | ".join(titles) + " |\n|" + " --- |" * len(titles))
        print(f"| {scenario} | " + " | ".join(cell(rounds, title) for title in rounds[0]) + " |")


def cell(rounds: list[dict[str, float]], title: str) -> str:
    """Returns the median over the rounds, with their range."""
    values = [measured[title] for measured in rounds]
    return f"{statistics.median(values):,.2f} ({min(values):,.2f}–{max(values):,.2f})"


def measure(flags: argparse.Namespace, framework: str, arm: str, count: int) -> dict[str, Any]:
    """Runs one arm. Returns the measurements of `rollouts.py` of each policy; none after an
    error, which is printed, so that the other arms still run."""
    original = arm == "O"
    command = [flags.original_python if original else flags.shim_python]
    command += [str(Path(__file__).with_name("rollouts.py")), framework, arm, flags.task]
    command += ["--environments", str(count), "--chunk", str(flags.chunk)]
    command += ["--steps", str(flags.steps), "--policies", *flags.policies]
    variables = {
        **os.environ,
        "PYTHONPATH": flags.original if original else flags.shim,
        "PYTHONWARNINGS": "ignore",
        # One thread for each environment, as users of the original set it.
        "OMP_NUM_THREADS": "1",
        "LP_NUM_THREADS": "1",
        "MUJOCO_GL": "egl",
        "PYOPENGL_PLATFORM": "egl",
    }
    if not original:
        # The shim must not write into the original's settings.
        variables["LIBERO_CONFIG_PATH"] = str(flags.out / "shim-settings")
    variables.pop("RLINF_EXT_MODULE", None)
    done = subprocess.run(command, env=variables, capture_output=True, text=True)
    if done.returncode:
        print(f"{framework}, {count}, {arm} failed: {done.stderr[-2500:]}", file=sys.stderr)
        return {}
    measured = json.loads(done.stdout.splitlines()[-1])
    print(f"{framework}, {count}, {arm}: {measured}", file=sys.stderr, flush=True)
    return measured


if __name__ == "__main__":
    main()
