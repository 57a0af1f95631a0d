"""Scenarios run with the original and with the shim: `scenarios.py NAME OUT`.

Each scenario is a list of labelled values, which `test_original.py` compares."""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import zipfile
from collections.abc import Callable
from typing import Any

import as_recorded  # noqa: F401
import numpy as np

from libero.libero import get_libero_path
from libero.libero.envs import OffScreenRenderEnv, SegmentationRenderEnv

Log = list[tuple[str, Any]]

# Tasks with fixtures and zones, an open drawer, a bowl in a drawer, a floor, a burning stove, and a
# stove that is off.
TASKS = {
    "goal": "libero_goal/put_the_bowl_on_the_plate",
    "drawer": "libero_10/KITCHEN_SCENE4_put_the_black_bowl_in_the_bottom_drawer_of_the_cabinet_and_close_it",
    "in_drawer": "libero_spatial/pick_up_the_black_bowl_in_the_top_drawer_of_the_wooden_cabinet_and_place_it_on_the_plate",
    "floor": "libero_object/pick_up_the_butter_and_place_it_in_the_basket",
    "stove": "libero_10/KITCHEN_SCENE8_put_both_moka_pots_on_the_stove",
    "turn_on": "libero_goal/turn_on_the_stove",
}


def make(task: str, kind: Any = OffScreenRenderEnv, **arguments: Any) -> Any:
    path = os.path.join(get_libero_path("bddl_files"), f"{TASKS[task]}.bddl")
    arguments = {"camera_heights": 128, "camera_widths": 128, **arguments}
    return kind(bddl_file_name=path, **arguments)


def make_without_frames(task: str, **arguments: Any) -> Any:
    return make(task, use_camera_obs=False, **arguments)


def initial_states(task: str) -> np.ndarray:
    path = os.path.join(get_libero_path("init_states"), f"{TASKS[task]}.pruned_init")
    with zipfile.ZipFile(path) as archive:
        return pickle.loads(archive.read("archive/data.pkl"))


def actions(count: int) -> np.ndarray:
    t = np.arange(count)
    moves = [0.5 * np.sin(2 * np.pi * t / (19 + 3 * j) + 0.6 * j) for j in range(6)]
    return np.stack([*moves, np.where(t % 20 < 10, -1.0, 1.0)], axis=1)


def generator_digest() -> str:
    state = np.random.get_state()
    return hashlib.sha256(repr((state[1].tolist(), state[2:])).encode()).hexdigest()


def log_placement(env: Any, log: Log, label: str, observation: Any) -> None:
    model = env.sim.model
    log.append((f"{label} generator", generator_digest()))
    log.append((f"{label} state", env.get_sim_state()))
    log.append((f"{label} body_pos", np.array(model.body_pos)))
    log.append((f"{label} body_quat", np.array(model.body_quat)))
    log.append((f"{label} observation", observation))


def resets(task: str, hard_reset: bool) -> Log:
    log: Log = []
    np.random.seed(11)
    env = make_without_frames(task, hard_reset=hard_reset)
    log.append(("constructed generator", generator_digest()))
    log.append(("constructed state", env.get_sim_state()))
    env.seed(7)
    for i in range(3):
        log_placement(env, log, f"reset {i}", env.reset())
        for j, action in enumerate(actions(3)):
            log.append((f"reset {i} step {j}", env.step(action)))
    env.seed(7)
    log_placement(env, log, "seeded again", env.reset())
    env.close()
    return log


def absolute_control() -> Log:
    env = make_without_frames("goal")
    env.seed(0)
    env.reset()
    observation = env.set_init_state(initial_states("goal")[3])
    for _ in range(10):
        observation, *_ = env.step([0.0] * 6 + [-1.0])
    for robot in env.robots:
        robot.controller.use_delta = False
    log: Log = []
    start = np.array(observation["robot0_eef_pos"])
    for i in range(25):
        target = start + [0.004 * i, -0.003 * i, -0.002 * i]
        turn = [np.pi, 0.02 * i, -0.01 * i]
        log.append((f"step {i}", env.step([*target, *turn, 1.0 if i > 12 else -1.0])))
        controller = env.robots[0].controller
        log.append((f"ee_pos {i}", np.array(controller.ee_pos)))
        log.append((f"ee_ori_mat {i}", np.array(controller.ee_ori_mat)))
    env.reset()
    log.append(("relative again", bool(env.robots[0].controller.use_delta)))
    for i, action in enumerate(actions(3)):
        log.append((f"relative step {i}", env.step(action)))
    env.close()
    return log


def states() -> Log:
    """Reads and writes states in the middle of an episode, with and without observing."""
    env = make_without_frames("drawer")
    env.seed(1)
    env.reset()
    log: Log = [("set", env.set_init_state(initial_states("drawer")[5]))]
    for i, action in enumerate(actions(12)):
        log.append((f"step {i}", env.step(action)))
    saved = env.get_sim_state()
    log.append(("saved", saved))
    for action in actions(5):
        env.step(action)
    env.set_state(saved)
    log.append(("set, not observed", env.env._get_observations()))
    log.append(("set, success", bool(env.check_success())))
    for i, action in enumerate(actions(3)):
        log.append((f"step after set {i}", env.step(action)))
    # Each of these calls shifts the time at which later steps observe.
    for i in range(27):
        log.append((f"regenerated {i}", env.regenerate_obs_from_state(saved)))
        if i % 3 == 0 or i > 20:
            log.append((f"step after regenerated {i}", env.step(actions(1)[0])))
    env.sim.forward()
    log.append(("observed", env.env._get_observations(force_update=True)))
    log.append(("time", float(env.sim.data.time)))
    env.close()
    return log


def horizon() -> Log:
    env = make_without_frames("goal", horizon=4)
    env.seed(0)
    env.reset()
    log: Log = []
    for i in range(4):
        _, reward, done, info = env.step(actions(1)[0])
        log.append((f"step {i}", (reward, bool(done), info)))
        log.append((f"ended {i}", (bool(env.env.done), env.env.timestep, env.env.horizon)))
    try:
        env.step(actions(1)[0])
        log.append(("after the end", "a step"))
    except ValueError:
        log.append(("after the end", "ValueError"))
    env.reset()
    log.append(("after reset", (bool(env.env.done), env.env.timestep)))
    env.close()
    env = make_without_frames("goal", horizon=2, ignore_done=True)
    env.reset()
    for _ in range(4):
        env.step(actions(1)[0])
    log.append(("ignored", (bool(env.env.done), env.env.timestep)))
    env.close()
    return log


def frames() -> Log:
    """Renders frames, depths, and pictures of the current state."""
    env = make("in_drawer", camera_depths=True, camera_heights=[96, 128], camera_widths=[128, 64])
    env.seed(2)
    log: Log = [("reset", env.reset())]
    log.append(("set", env.set_init_state(initial_states("in_drawer")[1])))
    for i, action in enumerate(actions(6)):
        log.append((f"step {i}", env.step(action)))
    env.sim.forward()
    log.append(("now", np.array(env.sim.render(camera_name="frontview", width=120, height=90))))
    env.set_state(initial_states("in_drawer")[2])
    env.sim.forward()
    image, depth = env.sim.render(camera_name="agentview", width=64, height=64, depth=True)
    log += [("then", np.array(image)), ("then depth", np.array(depth))]
    log.append(("observed before", env.env._get_observations()))
    env.close()
    return log


def segmentations() -> Log:
    log: Log = []
    for task in ("in_drawer", "floor"):
        env = make(task, SegmentationRenderEnv, camera_segmentations=["instance", "class"])
        env.seed(2)
        env.reset()
        observation = env.set_init_state(initial_states(task)[1])
        log.append((f"{task} observation", observation))
        log.append((f"{task} numbers", dict(env.segmentation_id_mapping)))
        log.append((f"{task} instances", list(env.env.model.instances_to_ids)))
        log.append((f"{task} classes", list(env.env.model.classes_to_ids)))
        log.append((f"{task} of geoms", sorted(env.env.model.geom_ids_to_instances.items())))
        log.append((f"{task} of interest", list(env.obj_of_interest)))
        env.close()
    env = make("goal", camera_segmentations="element", camera_names="frontview")
    log.append(("elements", env.reset()))
    env.close()
    return log


def stove() -> Log:
    """Turns on a stove, whose burner then glows; resets with and without reloading the model."""
    log: Log = []
    for hard_reset in (False, True):
        env = make("turn_on", hard_reset=hard_reset)
        env.seed(3)
        env.reset()
        state = np.array(initial_states("turn_on")[0])
        knob = 1 + env.sim.model.get_joint_qpos_addr("flat_stove_1_button")
        label = f"hard_reset={hard_reset}"
        log.append((f"{label} off", env.set_init_state(state)))
        state[knob] = 0.9
        log.append((f"{label} turned", env.set_init_state(state)))
        log.append((f"{label} success", bool(env.check_success())))
        for i in range(3):
            log.append((f"{label} step {i}", env.step([0.0] * 7)))
        log.append((f"{label} reset", env.reset()))
        log.append((f"{label} step after reset", env.step([0.0] * 7)))
        env.close()
    return log


def details() -> Log:
    """Reads values that scripts use besides observations."""
    env = make_without_frames("stove")
    env.seed(4)
    env.reset()
    env.set_init_state(initial_states("stove")[0])
    for action in actions(3):
        env.step(action)
    domain, sim = env.env, env.sim
    robot = env.robots[0]
    log: Log = [
        ("language", env.language_instruction),
        ("problem", (env.problem_name, env.domain_name)),
        ("parsed", {k: v for k, v in domain.parsed_problem.items()}),
        ("objects", {k: (v.name, v.category_name, list(v.joints), v.root_body) for k, v in domain.objects_dict.items()}),
        ("fixtures", {k: (v.name, v.category_name, list(v.joints), v.root_body) for k, v in domain.fixtures_dict.items()}),
        ("contact geoms", {k: list(v.contact_geoms) for k, v in domain.objects_dict.items()}),
        ("action_spec", [np.array(x) for x in domain.action_spec]),
        ("action_dim", domain.action_dim),
        ("names of observables", sorted(domain.active_observables)),
        ("body ids", dict(domain.obj_body_id)),
        ("base", (np.array(robot.base_pos), np.array(robot.base_ori))),
        ("init_qpos", np.array(robot.init_qpos)),
        ("limits", [np.array(x) for x in (*robot.action_limits, *robot.torque_limits)]),
        ("names", {k: list(getattr(sim.model, f"{k}_names")) for k in ("body", "joint", "site", "camera", "actuator", "sensor")}),
        ("counts", {k: int(getattr(sim.model, k)) for k in ("nq", "nv", "nu", "nbody", "njnt", "ngeom", "nsite", "ncam", "nlight", "nsensor")}),
        ("addresses", [sim.model.get_joint_qpos_addr(j) for j in sim.model.joint_names]),
        ("velocity addresses", [sim.model.get_joint_qvel_addr(j) for j in sim.model.joint_names]),
        ("name", robot.controller.name),
        ("constants", [np.array(getattr(robot.controller, k)) for k in ("kp", "kd", "input_max", "output_max", "output_min")]),
        ("contacts", bool(domain.check_contact(domain.objects[0]))),
        ("reward", domain.reward()),
    ]  # fmt: skip
    for array in (
        "cam_pos",
        "cam_quat",
        "cam_fovy",
        "light_pos",
        "site_rgba",
        "geom_size",
        "jnt_range",
    ):
        log.append((array, np.array(getattr(sim.model, array))))
    for array in (
        "qpos",
        "qvel",
        "ctrl",
        "body_xpos",
        "body_xquat",
        "body_xmat",
        "xipos",
        "site_xpos",
        "site_xmat",
        "geom_xpos",
        "geom_xmat",
        "cam_xpos",
        "cam_xmat",
        "qfrc_bias",
    ):
        log.append((array, np.array(getattr(sim.data, array))))
    joint = domain.objects[0].joints[-1]
    moved = np.array(sim.data.get_joint_qpos(joint)) + [0.02, 0, 0, 0, 0, 0, 0]
    sim.data.set_joint_qpos(joint, moved)
    sim.forward()
    log.append(("moved", np.array(sim.data.get_body_xpos(domain.objects[0].root_body))))
    log.append(("matrix", np.array(sim.data.get_site_xmat("gripper0_grip_site"))))
    log.append(("state", env.get_sim_state()))
    env.close()
    return log


SCENARIOS: dict[str, Callable[[], Log]] = {
    **{
        f"resets_{task}_{'hard' if hard else 'soft'}": lambda task=task, hard=hard: resets(
            task, hard
        )
        for task in ("goal", "drawer", "in_drawer", "floor", "stove")
        for hard in (True, False)
    },
    "absolute_control": absolute_control,
    "states": states,
    "horizon": horizon,
    "frames": frames,
    "segmentations": segmentations,
    "stove": stove,
    "details": details,
}

if __name__ == "__main__":
    name, out = sys.argv[1:]
    with open(out, "wb") as file:
        pickle.dump(SCENARIOS[name](), file)
