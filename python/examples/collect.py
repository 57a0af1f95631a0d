"""Collects episodes for reinforcement learning from many environments at once.

    python collect.py libero_object/0 libero_object/1 --num-envs 8 --episodes 32 --output episodes

writes an NPZ file per episode of T steps:

    <observation>        [T + 1, ...]  before each action, and at the end
    actions              [T, 7]
    rewards              [T]
    terminated           [T]           true if the goal held after the step
    truncated            [T]           true if the budget of steps was spent
    instruction          []            the task in words

Frames have the orientation of VLAs' training data for LIBERO: LIBERO's array [::-1, ::-1].
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import rollout_libero

Observations = dict[str, NDArray[Any]]


class RandomPolicy:
    """Uniformly random actions, as a starting point for learning."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def act(self, observations: Observations) -> NDArray[np.float64]:
        """Returns an action per environment, [n, 7]."""
        return self._rng.uniform(-1.0, 1.0, (len(observations["eef_pos"]), 7))


def observation_of(observations: Observations, index: int) -> Observations:
    """Returns one environment's observation. It is a copy, since a view would keep the frames of
    all environments in memory."""
    return {key: values[index].copy() for key, values in observations.items()}


def save(path: Path, seen: list[Observations], steps: list[Any], instruction: str) -> None:
    """Writes an episode's file: an observation before each step, and one at the end."""
    names = ("actions", "rewards", "terminated", "truncated")
    arrays = {name: np.array(values) for name, values in zip(names, zip(*steps), strict=True)}
    arrays |= {key: np.stack([observation[key] for observation in seen]) for key in seen[0]}
    np.savez_compressed(path, **arrays, instruction=np.array(instruction))


def collect(
    envs: rollout_libero.VectorEnvironment,
    policy: RandomPolicy,
    episodes: int,
    output: Path,
    seed: int,
) -> None:
    """Writes `episodes` episodes in the order of their ends."""
    observations, infos = envs.reset(seed=seed)
    seen = [[observation_of(observations, index)] for index in range(envs.num_envs)]
    steps: list[list[Any]] = [[] for _ in seen]
    has_ended = np.zeros(envs.num_envs, dtype=bool)
    written = 0
    while written < episodes:
        actions = policy.act(observations)
        observations, rewards, terminated, truncated, _ = envs.step(actions)
        for index in range(envs.num_envs):
            observation = observation_of(observations, index)
            if has_ended[index]:
                # With autoreset, this step was the reset and executed no action.
                seen[index], steps[index] = [observation], []
                continue
            ended = terminated[index], truncated[index]
            seen[index].append(observation)
            steps[index].append((actions[index], rewards[index], *ended))
            if any(ended) and written < episodes:
                path = output / f"episode_{written:05d}.npz"
                save(path, seen[index], steps[index], infos["instruction"][index])
                written += 1
        has_ended = np.logical_or(terminated, truncated)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tasks", nargs="+", metavar="TASK", help="for example libero_object/0")
    parser.add_argument("--num-envs", type=int, default=8, help="environments that step together")
    parser.add_argument("--episodes", type=int, default=8, help="episodes to write")
    parser.add_argument("--output", type=Path, default=Path("episodes"), help="folder to write")
    parser.add_argument("--assets", default="libero", help="`libero`, `primitives`, or a folder")
    parser.add_argument("--size", type=int, default=128, help="height and width of frames")
    parser.add_argument("--max-steps", type=int, help="steps of an episode (default: the suite's)")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()

    arguments.output.mkdir(parents=True, exist_ok=True)
    envs = rollout_libero.VectorEnvironment(
        arguments.tasks,
        arguments.num_envs,
        assets=arguments.assets,
        height=arguments.size,
        width=arguments.size,
        max_steps=arguments.max_steps,
        autoreset_mode=AutoresetMode.NEXT_STEP,
    )
    try:
        policy = RandomPolicy(arguments.seed)
        collect(envs, policy, arguments.episodes, arguments.output, arguments.seed)
    finally:
        envs.close()
    print(f"wrote {arguments.episodes} episodes to {arguments.output}")


if __name__ == "__main__":
    main()
