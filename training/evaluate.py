"""Counts how often a student succeeds in newly placed scenes: a quick check in its development.

    python -m training.evaluate --weights runs/second/student.safetensors --episodes 5

This is not the final measurement: campaigns measure students on the benchmark's own states.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from gymnasium.vector import AutoresetMode

import rollout_libero
from training.collect import compile_scenes, perturbation
from training.network import CHUNK
from training.observations import RENDERED
from training.student import Student
from training.wordings import TASK_NAMES, canonical, draw

UNSEEN_SEED = 1_000_003
"""Seed of wordings and placements. No training uses it by default."""


def evaluate(arguments: argparse.Namespace) -> None:
    """Runs the episodes concurrently and prints the number of successes."""
    device = torch.device(arguments.device)
    student = Student(arguments.weights, device)
    tasks = [name for name in TASK_NAMES if name.startswith(tuple(arguments.tasks))]
    compile_scenes([TASK_NAMES.index(name) for name in tasks], arguments.assets, arguments.threads)
    # Each environment runs several episodes in succession; environments of long tasks come first.
    most = max(1, arguments.envs // len(tasks))
    each = -(-arguments.episodes // most)
    concurrent = -(-arguments.episodes // each)
    names = [name for name in reversed(tasks) for _ in range(concurrent)]
    n, rng = len(names), np.random.default_rng(UNSEEN_SEED)
    drawn = {name: draw(name, concurrent + 1, UNSEEN_SEED)[1:] for name in tasks}
    instructions = [canonical(name) for name in names]
    if arguments.wordings == "drawn":
        instructions = [drawn[name].pop() for name in names]
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
    if arguments.perturbed:
        for index in range(n):
            env.set_perturbation(index, perturbation(rng))
    begun = time.monotonic()
    seeds = 0 if released else [UNSEEN_SEED + index for index in range(n)]
    observation, info = env.reset(seed=seeds)
    ended: dict[str, list[tuple[int, bool]]] = {name: [] for name in tasks}
    remaining = np.full(n, each)
    over = np.zeros(n, bool)
    while (remaining > 0).any() and time.monotonic() - begun < arguments.seconds:
        answers = student.act(observation, instructions)
        observation, _, terminated, truncated, info = env.step_chunk(
            answers[:, : arguments.actions]
        )
        over = terminated | truncated
        for index in np.flatnonzero(over & (remaining > 0)).tolist():
            state = info["init_state"][index]
            number = -1 if state is None else int(state)
            ended[names[index]].append((number, bool(terminated[index])))
        remaining -= over
    env.close()
    report(arguments, ended, time.monotonic() - begun)


def report(
    arguments: argparse.Namespace, ended: Mapping[str, Sequence[tuple[int, bool]]], seconds: float
) -> None:
    """Prints successes by suite and task, and writes them if requested."""
    if arguments.states == "released":
        # Environments that take turns may begin one round more than there are states.
        ended = {
            name: [episode for episode in dict(episodes).items() if episode[0] < arguments.episodes]
            for name, episodes in ended.items()
        }
    solved = {name: sum(success for _, success in episodes) for name, episodes in ended.items()}
    count = sum(map(len, ended.values()))
    total = sum(solved.values())
    print(f"{total} of {count} succeeded ({100 * total / max(count, 1):.1f} %) in {seconds:.0f} s")
    for suite in dict.fromkeys(name.split("/")[0] for name in ended):
        names = [name for name in ended if name.split("/")[0] == suite]
        by_task = " ".join(f"{solved[name]}/{len(ended[name])}" for name in names)
        successes = sum(solved[name] for name in names)
        tries = sum(len(ended[name]) for name in names)
        print(f"{suite:15} {successes}/{tries}   {by_task}", flush=True)
    if arguments.table:
        arguments.table.write_text(json.dumps(ended))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--episodes", type=int, default=5, help="episodes per task")
    parser.add_argument("--tasks", nargs="+", default=["libero"], help="prefixes of task names")
    parser.add_argument(
        "--states", choices=["sampled", "released"], default="sampled",
        help="new placements, or the benchmark's released states",
    )  # fmt: skip
    parser.add_argument("--envs", type=int, default=200, help="number of environments")
    parser.add_argument("--assets", default="libero", help="asset pack or its folder")
    parser.add_argument("--table", type=Path, help="file for each episode's outcome, JSON")
    parser.add_argument("--wordings", choices=["canonical", "drawn"], default="canonical")
    parser.add_argument(
        "--perturbed", action="store_true", help="perturb every episode, as in a collection"
    )
    parser.add_argument(
        "--actions", type=int, choices=[1, 2, 4, 8], default=CHUNK, help="executed per answer"
    )
    parser.add_argument("--seconds", type=float, default=600.0, help="time limit")
    parser.add_argument("--threads", type=int, default=16)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    evaluate(parser.parse_args())


if __name__ == "__main__":
    main()
