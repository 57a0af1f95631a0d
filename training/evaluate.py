"""How often a student succeeds in scenes placed anew: a quick look while it is developed.

    python -m training.evaluate --weights runs/second/student.safetensors --episodes 5

It is no study: campaigns of the product measure students, on the benchmark's own states.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import rollout_libero
import torch
from gymnasium.vector import AutoresetMode

from training.collect import perturbation
from training.network import CHUNK
from training.observations import RENDERED
from training.student import Student
from training.wordings import TASK_NAMES, canonical, draw

UNSEEN_SEED = 1_000_003
"""Of wordings and of placements; no training has it by default."""


def evaluate(arguments: argparse.Namespace) -> None:
    """Runs the episodes side by side and prints how many succeeded."""
    device = torch.device(arguments.device)
    student = Student(arguments.weights, device)
    tasks = [name for name in TASK_NAMES if name.split("/")[0] in arguments.suites]
    names = tasks * arguments.episodes
    rng = np.random.default_rng(UNSEEN_SEED)
    instructions = [canonical(name) for name in names]
    if arguments.wordings == "drawn":
        drawn = {name: draw(name, arguments.episodes + 1, UNSEEN_SEED)[1:] for name in tasks}
        instructions = [drawn[name].pop() for name in names]
    env = rollout_libero.VectorEnvironment(
        names,
        len(names),
        "primitives",
        threads=arguments.threads,
        height=RENDERED,
        width=RENDERED,
        orientation="upright",
        init_states="sampled",
        autoreset_mode=AutoresetMode.NEXT_STEP,
    )
    if arguments.perturbed:
        for index in range(len(names)):
            env.set_perturbation(index, perturbation(rng))
    begun = time.monotonic()
    observation, _ = env.reset(seed=[UNSEEN_SEED + index for index in range(len(names))])
    success = np.zeros(len(names), bool)
    running = np.ones(len(names), bool)
    while running.any() and time.monotonic() - begun < arguments.seconds:
        answers = student.act(observation, instructions)
        # Rollouts that have ended begin anew and run along; only the first ones count.
        observation, _, terminated, truncated, _ = env.step_chunk(answers[:, : arguments.actions])
        success |= running & terminated
        running &= ~(terminated | truncated)
    env.close()
    taken = time.monotonic() - begun
    unfinished = f", {running.sum()} not finished in the time" if running.any() else ""
    print(f"{success.sum()} of {(~running).sum()} succeeded in {taken:.0f} s{unfinished}")
    for suite in arguments.suites:
        own = np.array([name.split("/")[0] == suite for name in names]) & ~running
        shown = []
        for name in tasks:
            if name.split("/")[0] == suite:
                of_task = own & np.array([it == name for it in names])
                shown.append(f"{success[of_task].sum()}/{of_task.sum()}")
        print(f"{suite:15} {success[own].sum()}/{own.sum()}   {' '.join(shown)}")


def main() -> None:
    suites = list(dict.fromkeys(name.split("/")[0] for name in TASK_NAMES))
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--episodes", type=int, default=5, help="of each task")
    parser.add_argument("--suites", nargs="+", choices=suites, default=suites)
    parser.add_argument("--wordings", choices=["canonical", "drawn"], default="canonical")
    parser.add_argument(
        "--perturbed", action="store_true", help="as a collection is, every episode"
    )
    parser.add_argument(
        "--actions", type=int, choices=[1, 2, 4, 8], default=CHUNK, help="done of each answer"
    )
    parser.add_argument("--seconds", type=float, default=600.0, help="at most")
    parser.add_argument("--threads", type=int, default=16)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    evaluate(parser.parse_args())


if __name__ == "__main__":
    main()
