"""Counts how often the expert succeeds although another driver disturbs it for some steps.

    python -m training.check_expert --driver stranger --states 10

In each rollout the expert drives, and ``--driver`` names the disturbance:

- ``pushes``: a push is added to the expert's actions;
- ``stranger``: for some steps, another driver stands still, wanders, or repeats the expert's
  actions of a second ago. When standing still or wandering, it opens or closes the gripper at
  random;
- ``copy``: the expert never drives. Each step executes the action that the interrupted expert
  would take, as a student would that has learnt the labels without error;
- ``none``: the expert is not disturbed.

Rollouts begin at the benchmark's released states. With a disturbance, the step limit is twice the
benchmark's. No frames are rendered.
"""

import argparse
import os
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from gymnasium.vector import AutoresetMode

import rollout_libero
from training.wordings import TASK_NAMES

DISTURBANCE_STEPS = (5, 40)
"""Least number of steps of a disturbance, and the exclusive upper limit."""
EXPERT_STEPS = (20, 80)
"""Least number of steps that the expert drives before each disturbance, and the exclusive upper
limit."""
DISTURBANCES = 3
"""Largest number of disturbances in a rollout; an object dropped in a disturbance may stay out of
reach."""
DELAY = 20
"""Delay of the actions that a stranger repeats, control steps of 50 ms."""
WANDERING_SIZE = np.array([0.5, 0.5, 0.5, 0.1, 0.1, 0.1])
"""Largest action of a wandering stranger; a push is three times as large. Larger rotations would
end at the joint limits, from which no policy that commands the hand recovers."""
DELAYED, STILL, WANDERS = range(3)
"""Motions of a stranger: it repeats the expert's delayed actions, stands still, or repeats one
random action."""


def rollout(name: str, state: int, arguments: argparse.Namespace) -> tuple[bool, int]:
    """Runs a rollout. Returns True if it succeeded, and its number of steps."""
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
    delayed = deque([np.zeros(7)] * DELAY, maxlen=DELAY)
    interrupted, steps_left, steps, turns = False, int(rng.integers(*EXPERT_STEPS)), 0, 0
    motion, wander, gripper = STILL, np.zeros(6), -1.0
    while True:
        if steps_left == 0 and disturbed and turns < 2 * DISTURBANCES:
            interrupted, turns = not interrupted, turns + 1
            steps_left = int(rng.integers(*(DISTURBANCE_STEPS if interrupted else EXPERT_STEPS)))
            motion, gripper = int(rng.integers(3)), float(rng.choice([-1.0, 1.0]))
            wander = rng.uniform(-1.0, 1.0, 6) * WANDERING_SIZE
        steps_left -= 1
        action, expert = np.zeros(7), True
        if arguments.driver == "copy":
            action, expert = env.foresee(1)[0][0, 0], False
        elif interrupted and arguments.driver == "pushes":
            action[:6] = 3.0 * wander
        elif interrupted:
            arm = {DELAYED: delayed[0][:6], STILL: np.zeros(6), WANDERS: wander}[motion]
            action, expert = np.append(arm, delayed[0][6] if motion == DELAYED else gripper), False
        *_, terminated, truncated, info = env.step_chunk(
            action[np.newaxis, np.newaxis], "none", expert=np.full((1, 1), expert)
        )
        delayed.append(info["expert_action"][0, 0])
        steps += 1
        if terminated[0] or truncated[0]:
            env.close()
            return bool(terminated[0]), steps


def check(arguments: argparse.Namespace) -> None:
    """Runs the rollouts on ``--threads`` threads and prints the number of successes."""
    tasks = [name for name in TASK_NAMES if name.startswith(tuple(arguments.tasks))]
    states = range(arguments.states)
    start, solved = time.monotonic(), 0
    with ThreadPoolExecutor(arguments.threads) as pool:
        for name in tasks:
            # An open environment keeps the task's scene, so that it is compiled only once.
            scene_keeper = rollout_libero.VectorEnvironment(name, 1, arguments.assets, cameras=())
            results = list(pool.map(partial(rollout, name, arguments=arguments), states))
            scene_keeper.close()
            result_of_state = zip(states, results, strict=True)
            failed = [state for state, (success, _) in result_of_state if not success]
            successes = len(results) - len(failed)
            solved += successes
            median = int(np.median([steps for _, steps in results]))
            failures = f"   failed from states {failed}" if failed else ""
            print(
                f"{name:18} {successes}/{len(results)}  median {median} steps{failures}", flush=True
            )
    total, seconds = len(tasks) * len(states), time.monotonic() - start
    print(f"{arguments.driver}: {solved} of {total} in {seconds:.0f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--driver", choices=["none", "pushes", "stranger", "copy"], default="stranger"
    )
    parser.add_argument("--tasks", nargs="+", default=["libero"], help="prefixes of task names")
    parser.add_argument("--states", type=int, default=5, help="states per task")
    parser.add_argument("--assets", help="asset pack or its folder")
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--seed", type=int, default=0)
    check(parser.parse_args())


if __name__ == "__main__":
    main()
