"""Times rollouts as programs for reinforcement learning make them: of the original or of the
shim, whichever `libero` is installed, and of `rollout_libero`. Prints one line of JSON.

usage: training.py alone|sent|threads TASK [--environments N] [--chunk K] [--steps N] [--rollouts N]

`alone`: each environment in a process, which constructs a new one for each rollout and reads the
observation at the end of each chunk of actions, as SimpleVLA-RL does, and as openpi and OpenVLA-OFT
do without processes. With `--every-frame` it reads every observation, so that all are rendered.
`sent`: each environment in a process, constructed anew for each rollout, which sends every
observation to its parent, including 15 steps of settling (RLinf, verl-vla).
`threads`: the same rollouts of `TrainingEnvironment` in this process (rollout_libero.rlinf).

A rollout lasts from the request of its reset to its last result. Control steps are
those of the policy, without settling. All programs execute the same actions.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time

import numpy as np
from speed import SIDE, files

SETTLING = {"alone": 10, "sent": 15, "threads": 15}
NOTHING = [0.0] * 6 + [-1.0]
CAMERAS = ("agentview_image", "robot0_eye_in_hand_image")


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("mode", choices=["alone", "sent", "threads"])
    parser.add_argument("task")
    parser.add_argument("--environments", type=int, default=4)
    parser.add_argument("--chunk", type=int, default=8)
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--rollouts", type=int, default=2)
    parser.add_argument("--every-frame", action="store_true")
    given = parser.parse_args()
    given.steps -= given.steps % given.chunk
    work = {"alone": alone, "sent": sent, "threads": threads}[given.mode]
    # The first rollout, untimed, imports, compiles and fills caches.
    resets, chunks = work(given)
    steps = given.steps * given.environments
    print(
        json.dumps(
            {
                "steps_per_second": steps * given.rollouts / sum(chunks),
                "rollouts_per_second": given.environments
                * given.rollouts
                / (sum(resets) + sum(chunks)),
                "reset_ms": 1e3 * sum(resets) / given.rollouts,
            }
        )
    )


def actions(given: argparse.Namespace) -> np.ndarray:
    """Returns a smooth motion in the air, [environments, steps, 7]."""
    phase = np.linspace(0, 3, given.steps)[:, None] + np.arange(7)
    each = np.linspace(0.2, 0.4, given.environments)[:, None, None]
    return each * np.sin(phase)


class Remade:
    """An environment that every reset constructs anew."""

    def __init__(self, bddl: str) -> None:
        self.bddl = bddl
        self.env = None

    def reset(self):
        """Closes the environment, and creates, seeds and resets another."""
        from libero.libero.envs import OffScreenRenderEnv

        if self.env is not None:
            self.env.close()
        self.env = OffScreenRenderEnv(
            bddl_file_name=self.bddl, camera_heights=SIDE, camera_widths=SIDE
        )
        self.env.seed(0)
        return self.env.reset()

    def __getattr__(self, name: str):
        return getattr(self.env, name)


class Maker:
    """Constructs an environment in a spawned process."""

    def __init__(self, bddl: str) -> None:
        self.bddl = bddl

    def __call__(self) -> Remade:
        return Remade(self.bddl)


def look(seen) -> None:
    for camera in CAMERAS:
        assert seen[camera].shape == (SIDE, SIDE, 3)


def alone(given: argparse.Namespace) -> tuple[list[float], list[float]]:
    """Returns seconds of the resets and of the chunks, for each round of rollouts."""
    bddl, states = files(given.task)
    context = multiprocessing.get_context("spawn")
    # A barrier, so that a failed process ends the others, too.
    barrier = context.Barrier(given.environments + 1, timeout=900)
    started = [
        context.Process(
            target=roll_out, args=(given, bddl, states[at], actions(given)[at], barrier)
        )
        for at in range(given.environments)
    ]
    for process in started:
        process.start()
    resets, chunks = [], []
    for number in range(given.rollouts + 1):
        barrier.wait()
        begun = time.perf_counter()
        barrier.wait()
        reset = time.perf_counter()
        barrier.wait()
        if number:
            resets.append(reset - begun)
            chunks.append(time.perf_counter() - reset)
    for process in started:
        process.join()
    return resets, chunks


def roll_out(given, bddl: str, state: np.ndarray, moves: np.ndarray, barrier) -> None:
    """Runs a process's rollouts."""
    env = Remade(bddl)
    for _ in range(given.rollouts + 1):
        barrier.wait()
        seen = env.reset()
        seen = env.set_init_state(state)
        for _ in range(SETTLING["alone"]):
            seen, *_ = env.step(NOTHING)
            if given.every_frame:
                look(seen)
        look(seen)
        barrier.wait()
        for at, action in enumerate(moves, 1):
            seen, *_ = env.step(action)
            if given.every_frame or at % given.chunk == 0:
                look(seen)
        barrier.wait()
    env.close()


def sent(given: argparse.Namespace) -> tuple[list[float], list[float]]:
    """Returns the same seconds as `alone`, for processes that send every observation."""
    from libero.libero.envs import SubprocVectorEnv

    multiprocessing.set_start_method("spawn", force=True)
    bddl, states = files(given.task)
    count = given.environments
    made = SubprocVectorEnv([Maker(bddl)] * count)
    moves = actions(given)
    resets, chunks = [], []
    for number in range(given.rollouts + 1):
        begun = time.perf_counter()
        made.reset()
        made.set_init_state(states[:count])
        for _ in range(SETTLING["sent"]):
            seen, *_ = made.step([NOTHING] * count)
        reset = time.perf_counter()
        for at in range(given.steps):
            seen, *_ = made.step(moves[:, at])
        for one in seen:
            look(one)
        if number:
            resets.append(reset - begun)
            chunks.append(time.perf_counter() - reset)
    made.close()
    return resets, chunks


def threads(given: argparse.Namespace) -> tuple[list[float], list[float]]:
    """Returns the same seconds as `alone`, for threads in this process."""
    from rollout_libero.training import Start, TrainingEnvironment

    bddl, states = files(given.task)
    count = given.environments
    made = TrainingEnvironment(count, height=SIDE, width=SIDE, settle_steps=SETTLING["threads"])
    chunked = actions(given).reshape(count, -1, given.chunk, 7)
    resets, chunks = [], []
    for number in range(given.rollouts + 1):
        begun = time.perf_counter()
        made.reset([Start(bddl, state, seed=at) for at, state in enumerate(states[:count])])
        reset = time.perf_counter()
        for at in range(chunked.shape[1]):
            observation, _ = made.step_chunk(chunked[:, at])
        assert observation["agentview"].shape == (count, SIDE, SIDE, 3)
        if number:
            resets.append(reset - begun)
            chunks.append(time.perf_counter() - reset)
    made.close()
    return resets, chunks


if __name__ == "__main__":
    main()
