"""A rollout of ``Environment`` equals a campaign's rollout, step for step, under each axis."""

import json
import subprocess

import numpy as np
import pytest
from PIL import Image

from .conftest import TASK

STEPS = 6
AXES = ("camera", "lighting", "robot", "sensor", "actuation", "language", "simultaneous")
CAMERAS = ("agentview", "robot0_eye_in_hand")


def actions_beyond_range():
    """Returns actions with many values outside -1..1, which policies may also answer."""
    return np.random.default_rng(0).uniform(-2.5, 2.5, (STEPS, 7))


@pytest.mark.parametrize("axis", [*AXES, None])
def test_a_rollout_is_bit_identical_to_a_campaigns(make, programs, tmp_path, axis):
    task = TASK.removeprefix("libero_").replace("/", "/t")
    rollout = f"{task}/nominal/i03" if axis is None else f"{task}/{axis}/L3/c02"
    actions = actions_beyond_range()
    np.save(tmp_path / "actions.npy", actions)
    subprocess.run(
        [programs / "worker", "rollout", "--id", rollout, "--actions", tmp_path / "actions.npy",
         "--assets", "primitives", "--output", tmp_path / "output"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    trace = np.load(tmp_path / "output" / "trace.npz")
    assert (np.abs(trace["actions"]) > 1.0).any()
    row = json.loads((tmp_path / "output" / "result.json").read_text())["assignment"]["row"]

    environment = make(
        height=256, width=256, settle_steps=None, orientation="upright", init_states=3,
        perturbation=None if axis is None else rollout,
    )  # fmt: skip
    observation, info = environment.reset()
    assert (info["instruction"], info["init_state"]) == (row["language"], row["init_id"])
    check_frames(tmp_path, "first", observation)
    for step in range(STEPS + 1):
        if step:
            observation, _, terminated, _, _ = environment.step(actions[step - 1])
            assert terminated == trace["success"][step]
        qpos = environment.simulation.data_array("qpos")
        np.testing.assert_array_equal(qpos, trace["qpos"][step], err_msg=f"step {step}")
        names = (("eef_pos",) * 2, ("eef_quat", "eef_quat_xyzw"), ("joint_pos",) * 2)
        for observed, traced in names:
            np.testing.assert_array_equal(observation[observed], trace[traced][step])
    check_frames(tmp_path, "last", observation)


def check_frames(folder, moment, observation):
    for camera in CAMERAS:
        picture = Image.open(folder / "output" / "frames" / f"{moment}-{camera}.png")
        np.testing.assert_array_equal(observation[camera], np.asarray(picture), err_msg=moment)
