"""Evaluates a policy over tasks and their released initial states.

    python evaluate.py libero_spatial/0 libero_object/3 --episodes 10

Replace RandomPolicy by your own policy: an object with `reset` and `act`.
"""

import argparse
import math
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rollout_libero


class RandomPolicy:
    """Small random motions that demonstrate the loop; it solves nothing."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def reset(self, instruction: str) -> None:
        """Begins an episode."""

    def act(self, observation: dict[str, Any]) -> NDArray[np.floating[Any]]:
        """Returns the next actions [k, 7], all of which are executed: translation (3), rotation (3)
        and gripper (-1 opens, 1 closes), each from -1 to 1. Frames are uint8 [height, width, 3], by
        camera name, oriented as in the training of VLAs; pass the environment orientation="upright"
        for frames as a person sees the scene."""
        return np.clip(0.2 * self._rng.standard_normal((8, 7)), -1.0, 1.0)


def succeeds(
    env: rollout_libero.Environment, policy: RandomPolicy, init_state: int, seed: int
) -> bool:
    """Runs one episode until the goal holds or its steps are spent. Returns success."""
    observation, info = env.reset(seed=seed, options={"init_state": init_state})
    policy.reset(info["instruction"])
    while True:
        # The policy sees only the frames after a chunk, so only these are rendered.
        observation, _, terminated, truncated, info = env.step_chunk(
            policy.act(observation), render="last"
        )
        if terminated or truncated:
            return bool(info["success"])


def wilson(successes: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Returns the ends of Wilson's score interval of a success rate."""
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    rate, weight = successes / n, z * z / n
    centre = (rate + weight / 2) / (1 + weight)
    half = z * math.sqrt(rate * (1 - rate) / n + weight / (4 * n)) / (1 + weight)
    return max(0.0, centre - half), min(1.0, centre + half)


def line(name: str, successes: int, n: int) -> str:
    """Formats a task's line of the table, in percent."""
    low, high = wilson(successes, n)
    counts = f"{successes:4d} of {n:4d}"
    return f"{name:24s} {counts} {100 * successes / n:7.1f}   {100 * low:5.1f} to {100 * high:5.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tasks", nargs="+", metavar="TASK", help="for example libero_spatial/0")
    parser.add_argument(
        "--episodes",
        type=int,
        default=10,
        help="number of episodes per task, from initial states 0, 1, …",
    )
    parser.add_argument("--assets", default="libero", help="`libero`, `primitives`, or a folder")
    parser.add_argument("--max-steps", type=int, help="steps of an episode (default: the suite's)")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.episodes < 1:
        parser.error("--episodes must be 1 or more")

    policy = RandomPolicy(arguments.seed)
    print(f"{'task':24s} {'successes':>12s} {'rate %':>7s}   95 % interval")
    total = 0
    for task in arguments.tasks:
        with rollout_libero.Environment(
            task, assets=arguments.assets, max_steps=arguments.max_steps
        ) as env:
            successes = sum(
                succeeds(env, policy, init_state, arguments.seed + init_state)
                for init_state in range(arguments.episodes)
            )
        print(line(task, successes, arguments.episodes), flush=True)
        total += successes
    if len(arguments.tasks) > 1:
        print(line("all", total, arguments.episodes * len(arguments.tasks)))


if __name__ == "__main__":
    main()
