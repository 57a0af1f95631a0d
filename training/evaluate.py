"""Counts how often a student succeeds: a quick check during its development.

    python -m training.evaluate --weights runs/second/student.safetensors --episodes 5

By default, LIBERO's samplers place the objects. The final measurement is a campaign on the
benchmark's own states, not this command.
"""

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from gymnasium.vector import AutoresetMode

import rollout_libero
from training.collect import compile_scenes
from training.observations import RENDERED
from training.student import Student
from training.wordings import TASK_NAMES, canonical

UNSEEN_SEED = 1_000_003
"""Seed of placements. No training uses this seed by default."""


def evaluate(arguments: argparse.Namespace) -> None:
    """Runs the episodes concurrently and prints the number of successes."""
    device = torch.device(arguments.device)
    student = Student(arguments.weights, device)
    tasks = [name for name in TASK_NAMES if name.startswith(tuple(arguments.tasks))]
    compile_scenes([TASK_NAMES.index(name) for name in tasks], arguments.assets, arguments.threads)
    # Each environment runs some episodes in succession; environments of long tasks come first.
    most_per_task = max(1, arguments.envs // len(tasks))
    episodes_of_each = -(-arguments.episodes // most_per_task)
    per_task = -(-arguments.episodes // episodes_of_each)
    names = [name for name in reversed(tasks) for _ in range(per_task)]
    n = len(names)
    instructions = [canonical(name) for name in names]
    released = arguments.states == "released"
    env = rollout_libero.VectorEnvironment(
        names,
        n,
        arguments.assets,
        threads=arguments.threads,
        height=RENDERED,
        width=RENDERED,
        orientation="upright",
        init_states="cycle" if released else "sampled",
        autoreset_mode=AutoresetMode.NEXT_STEP,
    )
    start = time.monotonic()
    seeds = 0 if released else [UNSEEN_SEED + index for index in range(n)]
    observation, info = env.reset(seed=seeds)
    results: dict[str, list[tuple[int, bool]]] = {name: [] for name in tasks}
    remaining = np.full(n, episodes_of_each)
    ended = np.zeros(n, bool)
    while (remaining > 0).any() and time.monotonic() - start < arguments.seconds:
        answers = student.act(observation, instructions)
        observation, _, terminated, truncated, info = env.step_chunk(answers)
        ended = terminated | truncated
        for index in np.flatnonzero(ended & (remaining > 0)).tolist():
            state = info["init_state"][index]
            number = -1 if state is None else int(state)
            results[names[index]].append((number, bool(terminated[index])))
        remaining -= ended
    env.close()
    report(arguments, results, time.monotonic() - start)


def report(
    arguments: argparse.Namespace, results: Mapping[str, Sequence[tuple[int, bool]]], seconds: float
) -> None:
    """Prints the numbers of successes by suite and task, and writes the results to ``--table``, if
    that file is given: for each task, each episode's initial state and success."""
    if arguments.states == "released":
        # The environments of a task may together run more initial states than requested.
        results = {
            name: [episode for episode in dict(episodes).items() if episode[0] < arguments.episodes]
            for name, episodes in results.items()
        }
    solved = {name: sum(success for _, success in episodes) for name, episodes in results.items()}
    count = sum(map(len, results.values()))
    total = sum(solved.values())
    print(f"{total} of {count} succeeded ({100 * total / max(count, 1):.1f} %) in {seconds:.0f} s")
    for suite in dict.fromkeys(name.split("/")[0] for name in results):
        names = [name for name in results if name.split("/")[0] == suite]
        by_task = " ".join(f"{solved[name]}/{len(results[name])}" for name in names)
        successes = sum(solved[name] for name in names)
        episodes_of_suite = sum(len(results[name]) for name in names)
        print(f"{suite:15} {successes}/{episodes_of_suite}   {by_task}", flush=True)
    if arguments.table:
        arguments.table.write_text(json.dumps(results))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--weights", type=Path, required=True, help="file of the student's weights")
    parser.add_argument("--episodes", type=int, default=5, help="episodes per task")
    parser.add_argument("--tasks", nargs="+", default=["libero"], help="prefixes of task names")
    parser.add_argument(
        "--states", choices=["sampled", "released"], default="sampled",
        help="new placements, or the benchmark's released states",
    )  # fmt: skip
    parser.add_argument("--envs", type=int, default=200, help="number of environments")
    parser.add_argument("--assets", default="libero", help="asset pack or its folder")
    parser.add_argument("--table", type=Path, help="file for each episode's outcome, JSON")
    parser.add_argument("--seconds", type=float, default=600.0, help="time limit")
    parser.add_argument("--threads", type=int, default=16)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    evaluate(parser.parse_args())


if __name__ == "__main__":
    main()
