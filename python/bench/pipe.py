"""Time of the pipe against stepping the environment in-process, in turn in one run.

    python python/bench/pipe.py [--rounds N] [--steps N] [SPEC [OPTION ...] | NAME ...]

Prints a table of the simulator SPEC, or of those of `tests/env/test_simulators.py`, by default all
that this interpreter has. Each round runs the same rollout on both sides, step by step in
alternating order; every step observes all cameras. A time is the lower quartile of the steps' wall
times, which other processes of the machine disturb least. Construction is not counted: it is the
same.
"""

import argparse
import importlib.util
import os
import pathlib
import statistics
import sys
import time
from collections.abc import Iterable
from importlib import metadata

import numpy as np

from rollout_env import Client, Simulator, open_simulator
from rollout_env.check import check
from rollout_env.settings import arguments, settings

SEED = 3
COLUMNS = "simulator", "tasks", "cameras", "control", "check", "in-process", "pipe", "ratio"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    os.environ.setdefault("MUJOCO_GL", "egl")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=20)
    options, given = parser.parse_known_args()
    print_row(COLUMNS)
    print_row(["---"] * len(COLUMNS))
    is_spec = bool(given) and ":" in given[0]
    for name, spec in [(given[0], given)] if is_spec else installed(given):
        print_row([name, *row(spec, options.rounds, options.steps)])


def print_row(cells: Iterable[str]) -> None:
    print(f"| {' | '.join(cells)} |", flush=True)


def installed(names: list[str]) -> list[tuple[str, list[str]]]:
    """Returns the tested simulators of this interpreter with their versions, and their SPECs."""
    sys.path.append(str(pathlib.Path(__file__).parents[1] / "tests" / "env"))
    from test_simulators import FOLDERS, SIMULATORS

    sys.path += FOLDERS
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)
    owners = metadata.packages_distributions()
    return [
        (f"{owners[package][0]} {metadata.version(owners[package][0])}", spec.split())
        for name, (package, spec) in SIMULATORS.items()
        if name in (names or SIMULATORS) and importlib.util.find_spec(package)
    ]


def row(given: list[str], rounds: int, steps: int) -> list[str]:
    """Returns the cells after the simulator's name."""
    parser = argparse.ArgumentParser()
    arguments(parser)
    chosen = settings(parser.parse_args(given))
    findings = [finding.name for finding in check(lambda: open_simulator(chosen))]
    simulator = open_simulator(chosen)
    about = simulator.description
    inside, pipe = measure(simulator, given, rounds, steps)
    simulator.close()
    return [
        str(len(about.tasks)),
        ", ".join(f"{one.name} {one.width}×{one.height}" for one in about.cameras) or "none",
        f"{about.control_hz:g} Hz",
        ", ".join(findings) or "conforms",
        f"{inside:.2f} ms",
        f"{pipe:.2f} ms",
        f"{pipe / inside:.2f}",
    ]


def measure(simulator: Simulator, given: list[str], rounds: int, steps: int) -> list[float]:
    """Returns milliseconds per step, in-process and through the pipe."""
    about = simulator.description
    task, cameras = about.tasks[0].name, about.cameras
    actions = np.random.default_rng(0).uniform(-1, 1, (steps, len(about.action)))
    times: dict[str, list[float]] = {"in-process": [], "pipe": []}
    with Client([sys.executable, "-m", "rollout_env", "serve", *given]) as pipe:
        for _ in range(rounds):
            simulator.reset(task, SEED, {})
            pipe.reset(task, SEED, cameras)
            for index, action in enumerate(actions):
                for side in list(times) if index % 2 else list(times)[::-1]:
                    started = time.perf_counter()
                    if side == "pipe":
                        pipe.step([action.tolist()])
                        pipe.frames()
                    else:
                        simulator.step(action)
                        simulator.observe(cameras)
                    times[side].append((time.perf_counter() - started) * 1000)
    return [statistics.quantiles(values)[0] for values in times.values()]


if __name__ == "__main__":
    main()
