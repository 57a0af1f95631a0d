"""Compares the shim with recordings of the original: 23 tasks, two initial states each."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frames import assert_close_frames
from PIL import Image
from reference import SHARED

import rollout_libero
from libero.libero import benchmark
from libero.libero.envs import OffScreenRenderEnv

RECORDED = sorted((SHARED / "oracle" / "tasks-real").glob("*/*"))
CAMERAS = ("agentview", "robot0_eye_in_hand")
READINGS = ("eef_pos", "eef_quat", "gripper_qpos", "joint_pos_cos", "joint_pos_sin", "joint_vel")
#: Seed of the recordings.
SEED = 20260904
SETTLING = [0.0] * 6 + [-1.0]
#: Largest permitted difference of a position or reading from the original's, in its own unit.
NEAR = 1e-9
#: If the original's response to noise is smaller than this, `NEAR` is the limit in contact too.
CALM = 1e-11
SENSITIVITY = (
    json.loads((SHARED / "oracle" / "sensitivity.json").read_text())["tasks"] if RECORDED else {}
)

pytestmark = pytest.mark.skipif(not RECORDED, reason=f"no recordings in {SHARED / 'oracle'}")


@pytest.fixture(
    scope="module",
    params=RECORDED,
    ids=[f"{task.parent.name}-{task.name[:2]}" for task in RECORDED],
)
def task(request: pytest.FixtureRequest, real_assets: Path) -> Iterator[Path]:
    """The folder of a task's recordings. The task's scene is compiled once for all tests."""
    suite, i = suite_of(request.param)
    compiling_env = OffScreenRenderEnv(bddl_file_name=suite.get_task_bddl_file_path(i))
    yield request.param
    compiling_env.close()


def suite_of(task: Path) -> tuple[Any, int]:
    return benchmark.get_benchmark_dict()[task.parent.name](), int(task.name[:2])


def seeded(task: Path) -> OffScreenRenderEnv:
    """A new environment, seeded and reset once, as in the recording."""
    suite, i = suite_of(task)
    env = OffScreenRenderEnv(
        bddl_file_name=suite.get_task_bddl_file_path(i), camera_heights=256, camera_widths=256
    )
    set_frames_active(env, False)
    env.seed(SEED)
    env.reset()
    return env


def set_frames_active(env: OffScreenRenderEnv, active: bool) -> None:
    for camera in CAMERAS:
        env.env.modify_observable(f"{camera}_image", "active", active)


@pytest.mark.parametrize("initial_state", [0, 1])
def test_smooth_steps_give_the_originals_readings_and_frames(
    task: Path, initial_state: int
) -> None:
    recorded = np.load(task / f"traj_{initial_state}.npz")
    loaded = np.load(task / "init_dummy10.npz")
    suite, i = suite_of(task)
    env = seeded(task)
    model = env.sim.model
    np.testing.assert_allclose(model.body_pos, loaded["body_pos"][initial_state], atol=1e-12)
    np.testing.assert_allclose(model.body_quat, loaded["body_quat"][initial_state], atol=1e-12)

    env.set_init_state(suite.get_task_init_states(i)[initial_state])
    assert env.check_success() == loaded["success0"][initial_state]
    for _ in range(9):
        env.step(SETTLING)
    set_frames_active(env, True)
    settled = env.step(SETTLING)[0]
    check_frames(task, initial_state, 0, settled)
    set_frames_active(env, False)
    nq = model.nq
    np.testing.assert_allclose(
        env.get_sim_state()[1 : 1 + nq], loaded["qpos10"][initial_state], atol=NEAR
    )

    check_readings(recorded, 0, settled)
    for step, action in enumerate(recorded["actions"], start=1):
        if step == len(recorded["actions"]):
            set_frames_active(env, True)
        observation, reward, done, info = env.step(action)
        check_readings(recorded, step, observation)
        state = env.get_sim_state()
        np.testing.assert_allclose(state[1 : 1 + nq], recorded["qpos"][step], atol=NEAR)
        np.testing.assert_allclose(state[1 + nq :], recorded["qvel"][step], atol=1e-7)
        assert reward == recorded["reward"][step]
        assert done == recorded["done"][step]
        assert env.check_success() == recorded["success"][step]
        assert info == {}
    assert env.sim.data.time == pytest.approx(float(recorded["time"]), abs=1e-9)
    check_frames(task, initial_state, len(recorded["actions"]), observation)
    env.close()


def test_grasping_gives_the_originals_success_and_positions_within_rounding(task: Path) -> None:
    recorded = np.load(SHARED / "oracle" / "contact" / f"{task.parent.name}_{task.name[:2]}.npz")
    env = seeded(task)
    env.set_init_state(recorded["state"])
    for _ in range(10):
        env.step(SETTLING)
    assert env.check_success() == recorded["success"][0]
    nq = env.sim.model.nq
    for step, action in enumerate(recorded["actions"], start=1):
        _, _, done, _ = env.step(action)
        assert done == env.check_success() == recorded["success"][step]
        limit = permitted_error(task, step)
        qpos = env.get_sim_state()[1 : 1 + nq]
        np.testing.assert_allclose(qpos, recorded["qpos"][step], rtol=0, atol=limit)
    env.close()


def permitted_error(task: Path, step: int) -> float:
    """Returns the permitted error of positions at a step in contact: a hundred times the original's
    response to noise of 1e-14 in its torques, as in docs/dev/FIDELITY.md; infinite if the
    response was not measured."""
    measured = SENSITIVITY.get(f"{task.parent.name}/{int(task.name[:2])}", {}).get("contact")
    if measured is None:
        return np.inf
    # The response was measured at every twentieth step.
    response = measured[min((step - 1) // 20, len(measured) - 1)]
    return NEAR if response < CALM else 100 * response


def test_an_environments_frames_are_the_originals_turned_by_180_degrees(task: Path) -> None:
    suite, number = task.parent.name, int(task.name[:2])
    for orientation, turned in (
        (None, lambda raw: raw[::-1, ::-1]),
        ("upright", lambda raw: raw[::-1]),
    ):
        options = {} if orientation is None else {"orientation": orientation}
        env = rollout_libero.Environment(f"{suite}/{number}", init_states=0, **options)
        observation, _ = env.reset()
        for camera in CAMERAS:
            name = f"img_0_00_{camera}.png"
            recorded = recorded_frame(task, name)
            assert_close_frames(observation[camera], turned(recorded), f"{task.name}/{name}")
        env.close()


def recorded_frame(task: Path, name: str) -> Any:
    """Returns the original's frame in the default look."""
    folder = SHARED / "oracle" / "tasks-look" / task.parent.name / task.name
    return np.asarray(Image.open(folder / name).convert("RGB"))


def check_readings(recorded: Any, step: int, observation: Any) -> None:
    for name in READINGS:
        np.testing.assert_allclose(
            observation[f"robot0_{name}"], recorded[f"obs_{name}"][step], atol=NEAR
        )


def check_frames(task: Path, initial_state: int, step: int, observation: Any) -> None:
    for camera in CAMERAS:
        name = f"img_{initial_state}_{step:02d}_{camera}.png"
        theirs = recorded_frame(task, name)
        assert_close_frames(observation[f"{camera}_image"], theirs, f"{task.name}/{name}")
