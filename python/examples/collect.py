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
        n = len(observations["eef_pos"])
        return self._rng.uniform(-1.0, 1.0, (n, 7))


class Episode:
    """Observations and actions of one environment since its reset."""

    def __init__(self, observation: Observations, instruction: str) -> None:
        self._instruction = instruction
        self._observations = [observation]
        self._steps: list[tuple[NDArray[Any], float, bool, bool]] = []

    def add(
        self,
        action: NDArray[Any],
        reward: float,
        terminated: bool,
        truncated: bool,
        observation: Observations,
    ) -> None:
        """Adds a step and the observation after it."""
        self._steps.append((action, reward, terminated, truncated))
        self._observations.append(observation)

    def __len__(self) -> int:
        return len(self._steps)

    def save(self, path: Path) -> None:
        """Writes the episode's file."""
        actions, rewards, terminated, truncated = map(np.array, zip(*self._steps, strict=True))
        stacked = {
            key: np.stack([observation[key] for observation in self._observations])
            for key in self._observations[0]
        }
        np.savez_compressed(
            path,
            **stacked,
            actions=actions,
            rewards=rewards,
            terminated=terminated,
            truncated=truncated,
            instruction=np.array(self._instruction),
        )


def observation_of(observations: Observations, index: int) -> Observations:
    """Returns one environment's observation. It is a copy, since a view would keep the frames of
    all environments in memory."""
    return {key: values[index].copy() for key, values in observations.items()}


def collect(
    envs: rollout_libero.VectorEnvironment,
    policy: RandomPolicy,
    episodes: int,
    output: Path,
    seed: int,
) -> tuple[int, int]:
    """Writes `episodes` episodes in the order of their ends. Returns their total numbers of steps
    and successes."""
    observations, infos = envs.reset(seed=seed)
    instructions = [str(text) for text in infos["instruction"]]
    running = [
        Episode(observation_of(observations, index), instructions[index])
        for index in range(envs.num_envs)
    ]
    has_ended = np.zeros(envs.num_envs, dtype=bool)
    written = steps = successes = 0
    while written < episodes:
        actions = policy.act(observations)
        observations, rewards, terminated, truncated, _ = envs.step(actions)
        for index in range(envs.num_envs):
            observation = observation_of(observations, index)
            if has_ended[index]:
                # With autoreset, this step was the reset and executed no action.
                running[index] = Episode(observation, instructions[index])
                continue
            episode = running[index]
            ending = bool(terminated[index]), bool(truncated[index])
            episode.add(actions[index], float(rewards[index]), *ending, observation)
            if any(ending) and written < episodes:
                episode.save(output / f"episode_{written:05d}.npz")
                written += 1
                steps += len(episode)
                successes += ending[0]
        has_ended = np.logical_or(terminated, truncated)
    return steps, successes


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
        steps, successes = collect(
            envs, RandomPolicy(arguments.seed), arguments.episodes, arguments.output, arguments.seed
        )
    finally:
        envs.close()
    print(
        f"wrote {arguments.episodes} episodes, {steps} steps, {successes} successes"
        f" to {arguments.output}"
    )


if __name__ == "__main__":
    main()
