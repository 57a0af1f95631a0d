"""Compares the success of recorded trajectories in rollout_libero and in the original LIBERO,
without rendering.

usage: trajectories.py record FOLDER [--each N] [--tasks TASK …]   with rollout_libero
       trajectories.py replay FOLDER                               with the original LIBERO
       trajectories.py table FOLDER                                prints the comparison

`record` runs the scripted expert from the first N released states of every task, and writes its
actions, the robot's readings and the success of each step. `replay` executes the same actions in
the original, whose MuJoCo detects collisions as the benchmark's does (`nativeccd` off). Existing
files are kept, so both commands continue where they were interrupted.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from pathlib import Path
from typing import Any

import numpy as np
from checks import NO_OP, READINGS, SETTLING, SUCCESS_STEPS, TOLERANCE, touches
from rollouts import task_files
from stand_ins import prepare

#: Control steps of a recording after its success.
AFTER_SUCCESS = 5
#: Suites, each a row of the table.
_SUITES = ("libero_spatial", "libero_object", "libero_goal", "libero_10")


def main() -> None:
    """Runs the command line."""
    prepare()
    parser = argparse.ArgumentParser()
    parser.add_argument("work", choices=["record", "replay", "table"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--each", type=int, default=5)
    parser.add_argument("--tasks", nargs="+")
    flags = parser.parse_args()
    flags.folder.mkdir(parents=True, exist_ok=True)
    if flags.work == "record":
        for task in flags.tasks or [f"{suite}/{at}" for suite in _SUITES for at in range(10)]:
            record(task, flags.each, flags.folder)
    elif flags.work == "replay":
        for file in sorted(flags.folder.glob("*.recorded.npz")):
            replay(file)
    else:
        print("\n".join(table(flags.folder)))


def record(task: str, each: int, folder: Path) -> None:
    """Writes the trajectories of a task: actions [rows, steps, 7], readings [rows, steps, …],
    success [rows, steps], and ends [rows]: the number of steps of each row, which ends
    `AFTER_SUCCESS` steps after its first success, at the latest with the task's budget."""
    from rollout_libero._library import native
    from rollout_libero.tasks import Task
    from rollout_libero.training import LOADS, Start, TrainingEnvironment

    file = folder / f"{task.replace('/', '-')}.recorded.npz"
    if file.exists():
        return
    bddl, states = task_files(task)
    envs = TrainingEnvironment(each, cameras=[], settle_steps=SETTLING)
    # `replay` resets one environment of the original for all trajectories, so that each trajectory
    # has one reset more than the previous one.
    envs.reset([Start(bddl, states[at], loads=LOADS + at) for at in range(each)])
    batch = native.Batch(envs.simulations, threads=2)
    steps: list[dict[str, Any]] = []
    ends = np.full(each, Task.of(task).max_steps)
    while len(steps) < ends.max():
        step = batch.advance(
            np.zeros((each, 1, 7)),
            [1] * each,
            [None] * each,
            [],
            expert=np.ones((each, 1), bool),
            past_success=True,
        )
        steps.append(step)
        done = step["successes"][:, 0] & (ends > len(steps) + AFTER_SUCCESS)
        ends[done] = len(steps) + AFTER_SUCCESS
    envs.close()
    parts = ("joint_pos", "eef_pos", "eef_quat", "gripper_pos")
    np.savez_compressed(
        file,
        actions=np.stack([step["expert_action"][:, 0] for step in steps], axis=1),
        readings=np.stack(
            [np.concatenate([step[part] for part in parts], axis=-1) for step in steps], axis=1
        ),
        success=np.stack([step["successes"][:, 0] for step in steps], axis=1),
        ends=ends,
    )
    print(f"{task}: ended after {ends.tolist()} steps", flush=True)


def replay(recorded: Path) -> None:
    """Executes a task's recorded actions in the original. Writes the robot's readings, the success
    of each step, and the first step after which the robot touches something."""
    from libero.libero.envs.env_wrapper import ControlEnv

    file = recorded.with_name(recorded.name.replace(".recorded.", ".replayed."))
    if file.exists():
        return
    _collide_as_recorded()
    recording = np.load(recorded)
    task = recorded.name.partition(".")[0].replace("-", "/")
    bddl, states = task_files(task)
    env = ControlEnv(
        bddl_file_name=bddl,
        use_camera_obs=False,
        has_renderer=False,
        has_offscreen_renderer=False,
        ignore_done=True,
    )
    readings = np.full_like(recording["readings"], np.nan)
    success = np.zeros_like(recording["success"])
    contacts = []
    for row, end in enumerate(recording["ends"]):
        env.seed(0)
        env.reset()
        env.set_init_state(states[row])
        for _ in range(SETTLING):
            env.step(NO_OP)
        contact = 0
        for step, action in enumerate(recording["actions"][row, :end]):
            observation, *_ = env.step(action)
            readings[row, step] = np.concatenate([observation[name] for name in READINGS])
            success[row, step] = env.check_success()
            if not contact and touches(env):
                contact = step + 1
        contacts.append(contact)
    env.close()
    np.savez_compressed(file, readings=readings, success=success, contacts=contacts)
    print(f"{task}: replayed", flush=True)


def table(folder: Path) -> list[str]:
    """Returns the comparison, a row for each suite, and the trajectories that differ."""
    rows = [
        "| | trajectories | solved here, in the original | at the same step | within "
        f"{SUCCESS_STEPS} steps | largest difference before contact | first difference above "
        f"{TOLERANCE:g}, step | first contact, step |",
        "| --- |" + " --- |" * 7,
    ]
    different = []
    trajectories = []
    for suite in _SUITES:
        suite_trajectories = []
        for recorded in sorted(folder.glob(f"{suite}-*.recorded.npz")):
            replayed = recorded.with_name(recorded.name.replace(".recorded.", ".replayed."))
            if not replayed.exists():
                continue
            here, there = np.load(recorded), np.load(replayed)
            for row, end in enumerate(here["ends"]):
                trajectory = compare_row(here, there, row, int(end))
                suite_trajectories.append(trajectory)
                if not trajectory["within"]:
                    task = recorded.name.partition(".")[0]
                    different.append(f"{task}, state {row}: {trajectory}")
        if suite_trajectories:
            rows.append(_table_row(suite, suite_trajectories))
        trajectories += suite_trajectories
    rows.append(_table_row("all", trajectories))
    return [*rows, "", *different]


def compare_row(here: Any, there: Any, row: int, end: int) -> dict[str, Any]:
    """Compares one trajectory in rollout_libero (`here`) and in the original (`there`). Steps count
    from 1; step 0 means never."""

    def first_step(holds: Any) -> int:
        return int(np.argmax(holds)) + 1 if np.any(holds) else 0

    differences = np.abs(here["readings"][row, :end] - there["readings"][row, :end]).max(axis=1)
    ours, theirs = (first_step(side["success"][row, :end]) for side in (here, there))
    contact = int(there["contacts"][row])
    before = differences[: contact - 1] if contact else differences
    return {
        "here": ours,
        "there": theirs,
        "within": (not ours) == (not theirs) and abs(ours - theirs) <= SUCCESS_STEPS,
        "contact": contact,
        "differs": first_step(differences > TOLERANCE),
        "before": float(before.max(initial=0.0)),
    }


def _table_row(name: str, trajectories: list[dict[str, Any]]) -> str:
    def spread(key: str) -> str:
        steps = [each[key] for each in trajectories if each[key]]
        never = len(trajectories) - len(steps)
        words = f"{statistics.median(steps):.0f} ({min(steps)}–{max(steps)})" if steps else ""
        return ", ".join(filter(None, [words, f"never in {never}" if never else ""]))

    solved = [sum(each[side] > 0 for each in trajectories) for side in ("here", "there")]
    cells = [
        name,
        str(len(trajectories)),
        f"{solved[0]}, {solved[1]}",
        str(sum(each["here"] == each["there"] for each in trajectories)),
        str(sum(each["within"] for each in trajectories)),
        f"{max(each['before'] for each in trajectories):.1e}",
        spread("differs"),
        spread("contact"),
    ]
    return "| " + " | ".join(cells) + " |"


def _collide_as_recorded() -> None:
    """Makes the original detect collisions as the benchmark's MuJoCo 2.3.7 does."""
    import mujoco
    from robosuite.utils import binding_utils

    construct = binding_utils.MjSim.__init__

    def init(self: Any, model: Any) -> None:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
        construct(self, model)

    binding_utils.MjSim.__init__ = init


if __name__ == "__main__":
    sys.exit(main())
