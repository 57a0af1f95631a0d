"""Counts how often the expert succeeds although it is disturbed for stretches of steps.

    python -m training.check_expert --driver stranger --states 10

In each rollout the expert drives, with interruptions: ``pushes`` adds a push to its
actions; a ``stranger`` stands still, wanders, or repeats the expert's actions of a
second ago, with a gripper command of its own. A ``copy`` drives alone, and executes at every
step what the interrupted expert would do: a student that has learnt its labels without error.
The expert begins at the benchmark's
released states and has twice the benchmark's steps. No frames are rendered.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import rollout_libero
from training.wordings import TASK_NAMES

STRETCH = (5, 40)
"""Least and most steps of a disturbance."""
BETWEEN = (20, 80)
"""Least and most steps that the expert drives before each disturbance."""
STRETCHES = 3
"""Disturbances of a rollout. An object dropped during one may stay out of reach."""
DELAY = 20
"""Delay of the actions that a stranger repeats, control steps of 50 ms."""
WANDERING = np.array([0.5, 0.5, 0.5, 0.1, 0.1, 0.1])
"""Largest action of a wandering stranger; a push is three times as large. Larger rotations would
end at the joint limits, from which no policy that commands the hand recovers."""
LATE, STILL, WANDERS = range(3)
"""Motions of a stranger: the expert's delayed actions, none, or one random action."""


def rollout(name: str, state: int, arguments: argparse.Namespace) -> tuple[bool, int]:
    """Returns True if the rollout succeeded, and its number of steps."""
    disturbed = arguments.driver != "none"
    env = rollout_libero.VectorEnvironment(
        name,
        1,
        arguments.assets,
        threads=1,
        cameras=(),
        init_states="cycle",
        max_steps=(1 + disturbed) * rollout_libero.Task.of(name).max_steps,
        autoreset_mode=AutoresetMode.DISABLED,
    )
    env.reset(seed=state)
    rng = np.random.default_rng([arguments.seed, TASK_NAMES.index(name), state])
    late = deque([np.zeros(7)] * DELAY, maxlen=DELAY)
    interrupted, left, steps, turns = False, int(rng.integers(*BETWEEN)), 0, 0
    motion, wander, gripper = STILL, np.zeros(6), -1.0
    while True:
        if left == 0 and disturbed and turns < 2 * STRETCHES:
            interrupted, turns = not interrupted, turns + 1
            left = int(rng.integers(*(STRETCH if interrupted else BETWEEN)))
            motion, gripper = int(rng.integers(3)), float(rng.choice([-1.0, 1.0]))
            wander = rng.uniform(-1.0, 1.0, 6) * WANDERING
        left -= 1
        action, expert = np.zeros(7), True
        if arguments.driver == "copy":
            action, expert = expert_action(env), False
        elif interrupted and arguments.driver == "pushes":
            action[:6] = 3.0 * wander
        elif interrupted:
            own = {LATE: late[0][:6], STILL: np.zeros(6), WANDERS: wander}[motion]
            action, expert = np.append(own, late[0][6] if motion == LATE else gripper), False
        *_, terminated, truncated, info = env.step_chunk(
            action[np.newaxis, np.newaxis], "none", expert=np.full((1, 1), expert)
        )
        late.append(info["expert_action"][0, 0])
        steps += 1
        if terminated[0] or truncated[0]:
            env.close()
            return bool(terminated[0]), steps


def expert_action(env: rollout_libero.VectorEnvironment) -> NDArray[np.float64]:
    """Returns the expert's next action, and leaves the environment in its state."""
    before = env.snapshot()
    *_, info = env.step_chunk(np.zeros((1, 1, 7)), "none", expert=np.zeros((1, 1), bool))
    env.restore(before)
    action: NDArray[np.float64] = info["expert_action"][0, 0]
    return action


def check(arguments: argparse.Namespace) -> None:
    """Runs the rollouts on some threads and prints the successes."""
    tasks = [name for name in TASK_NAMES if name.startswith(tuple(arguments.tasks))]
    states = range(arguments.first, arguments.first + arguments.states)
    begun, solved = time.monotonic(), 0
    with ThreadPoolExecutor(arguments.threads) as pool:
        for name in tasks:
            # One environment stays open, so that the task's scene is compiled once.
            kept = rollout_libero.VectorEnvironment(name, 1, arguments.assets, cameras=())
            ended = list(pool.map(partial(rollout, name, arguments=arguments), states))
            kept.close()
            solves = zip(states, ended, strict=True)
            failed = [state for state, (success, _) in solves if not success]
            solved += len(ended) - len(failed)
            median = int(np.median([steps for _, steps in ended]))
            shown = f"   failed from states {failed}" if failed else ""
            print(
                f"{name:18} {len(ended) - len(failed)}/{len(ended)}  median {median}{shown}",
                flush=True,
            )
    total, seconds = len(tasks) * len(states), time.monotonic() - begun
    print(f"{arguments.driver}: {solved} of {total} in {seconds:.0f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--driver", choices=["none", "pushes", "stranger", "copy"], default="stranger"
    )
    parser.add_argument("--tasks", nargs="+", default=["libero"], help="prefixes of task names")
    parser.add_argument("--states", type=int, default=5, help="states per task")
    parser.add_argument("--first", type=int, default=0, help="number of the first state")
    parser.add_argument("--assets", help="asset pack or its folder")
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--seed", type=int, default=0)
    check(parser.parse_args())


if __name__ == "__main__":
    main()
