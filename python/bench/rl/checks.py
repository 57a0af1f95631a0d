"""Checks that a comparison of the original LIBERO with rollout-libero is fair: the same motion in
both simulators. Also reads the name of the original's OpenGL renderer.

usage: checks.py record TASK FILE    records the scripted expert's actions in rollout_libero
       checks.py replay TASK FILE    replays these actions in the installed `libero`; prints JSON"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from stand_ins import prepare

#: Largest number of control steps that the expert has for a task.
MAX_STEPS = 300
#: Largest difference of a reading (rad or m) before the robot first touches anything.
TOLERANCE = 1e-9
#: Largest difference between the steps at which the two simulators reach the goal.
SUCCESS_STEPS = 2
#: Index of the initial state.
_STATE = 0
NO_OP = [0.0] * 6 + [-1.0]
#: Number of steps after a reset in which objects settle.
SETTLING = 10
READINGS = ("robot0_joint_pos", "robot0_eef_pos", "robot0_eef_quat", "robot0_gripper_qpos")


def main() -> None:
    """Runs the command line."""
    prepare()
    work, task, file = sys.argv[1:]
    if work == "record":
        np.save(file, record_actions(task))
        print(json.dumps({"steps": len(np.load(file))}))
    else:
        print(json.dumps(replay(task, np.load(file))))


def record_actions(task: str) -> np.ndarray:
    """Returns the scripted expert's actions until shortly after success, [steps, 7]."""
    import rollout_libero

    envs = rollout_libero.VectorEnvironment(
        task, 1, cameras=[], init_states=[_STATE], settle_steps=SETTLING, autoreset_mode="Disabled"
    )
    envs.reset(seed=0)
    actions = []
    for _ in range(MAX_STEPS):
        *_, infos = envs.step_chunk(np.zeros((1, 1, 7)), expert=np.ones((1, 1), bool))
        actions.append(infos["expert_action"][0, 0])
        if infos["success"][0]:
            # The other simulator may reach the goal up to SUCCESS_STEPS later.
            actions += [actions[-1]] * (SUCCESS_STEPS + 3)
            break
    envs.close()
    return np.asarray(actions)


def replay(task: str, actions: np.ndarray) -> dict[str, Any]:
    """Executes actions. Returns the robot's readings per step, the steps of success and of the
    robot's first contact, and the renderer."""
    from rollouts import task_files

    from libero.libero.envs import OffScreenRenderEnv

    bddl, states = task_files(task)
    env = OffScreenRenderEnv(bddl_file_name=bddl, camera_heights=64, camera_widths=64)
    env.seed(0)
    env.reset()
    env.set_init_state(states[_STATE])
    for _ in range(SETTLING):
        env.step(NO_OP)
    readings, success, contact = [], None, None
    for step, action in enumerate(actions, 1):
        observation, _, _, _ = env.step(action.tolist())
        readings.append(
            np.concatenate([np.asarray(observation[name]) for name in READINGS]).tolist()
        )
        if success is None and env.check_success():
            success = step
        if contact is None and touches(env):
            contact = step
    result = {"readings": readings, "success": success, "contact": contact, "renderer": _renderer()}
    env.close()
    return result


def touches(env: Any) -> bool | None:
    """Returns True if the robot touches another body; None without robosuite, as in the shim."""
    try:
        from robosuite.utils import binding_utils  # noqa: F401
    except ImportError:
        return None
    model, data = env.sim.model, env.sim.data
    for number in range(data.ncon):
        contact = data.contact[number]
        names = [
            model.body_id2name(model.geom_bodyid[geom]) for geom in (contact.geom1, contact.geom2)
        ]
        robot = [str(name).startswith(("robot0_", "gripper0_", "mount0_")) for name in names]
        if robot[0] != robot[1]:
            return True
    return False


def _renderer() -> str | None:
    """Returns the name of the current OpenGL renderer; None without one."""
    try:
        import robosuite  # noqa: F401
        from OpenGL import GL
    except ImportError:
        return None
    name = GL.glGetString(GL.GL_RENDERER)
    return name.decode() if name else None


def verdict(theirs: dict[str, Any], ours: dict[str, Any]) -> dict[str, Any]:
    """Compares two replays: fair if `same_motion` and `same_success` hold."""
    free_steps = (theirs["contact"] or len(theirs["readings"]) + 1) - 1
    differences = np.abs(np.asarray(theirs["readings"]) - np.asarray(ours["readings"]))
    before_contact = float(differences[:free_steps].max()) if free_steps else 0.0
    successes = (theirs["success"], ours["success"])
    return {
        "first_contact": theirs["contact"],
        "apart_before_contact": before_contact,
        "success_original": successes[0],
        "success_shim": successes[1],
        "renderer": theirs["renderer"],
        "same_motion": before_contact <= TOLERANCE,
        "same_success": successes[0] == successes[1]
        or (None not in successes and abs(successes[0] - successes[1]) <= SUCCESS_STEPS),
    }


if __name__ == "__main__":
    main()
