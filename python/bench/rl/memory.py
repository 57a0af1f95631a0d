"""Prints the memory that a further row of a `TrainingEnvironment` takes, MiB of PSS: the growth of
this process, divided by the number of added rows.

usage: memory.py [TASK] [--rows N N]
"""

from __future__ import annotations

import argparse

import numpy as np
from measure import pss_mib

from rollout_libero.training import Start, TrainingEnvironment

#: Chunks of eight steps, enough for the renderer to cache the objects that do not move.
_CHUNKS = 12


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("task", nargs="?", default="libero_goal/8")
    parser.add_argument("--rows", nargs="+", type=int, default=[16, 48])
    flags = parser.parse_args()
    # A first row, which is not counted, loads the libraries and the scene.
    kept_alive = [_rows(flags.task, 1)]
    before = pss_mib()
    for count in flags.rows:
        kept_alive.append(_rows(flags.task, count))
        now = pss_mib()
        print(f"{flags.task}, {count} rows: {(now - before) / count:.2f} MiB each")
        before = now


def _rows(task: str, count: int) -> tuple[TrainingEnvironment, object]:
    """Returns rows that have stepped, and their last observation."""
    envs = TrainingEnvironment(count)
    envs.reset([Start(task, seed=seed) for seed in range(count)])
    moves = np.random.default_rng(0).uniform(-0.3, 0.3, (_CHUNKS, count, 8, 7))
    observation = None
    for chunk in moves:
        observation = envs.step_chunk(chunk).observation
    return envs, observation


if __name__ == "__main__":
    main()
