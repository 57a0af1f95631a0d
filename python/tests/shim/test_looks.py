"""Both looks of one scene, from the worker, the environments and LIBERO's own interface."""

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import rollout_libero
from libero.libero import benchmark
from libero.libero.envs import OffScreenRenderEnv
from rollout_libero._library import native

TASK = "libero_object/0"
CAMERAS = ("agentview", "robot0_eye_in_hand")
STATE = 3
REST = np.array([0.0, 0, 0, 0, 0, 0, -1])
Frames = dict[str, NDArray[np.uint8]]


def of_the_worker(look: str, programs: Path, folder: Path) -> Frames:
    np.save(folder / "actions.npy", REST[None])
    subprocess.run(
        [programs / "worker", "rollout", "--id", f"object/t0/nominal/i{STATE:02}",
         "--actions", folder / "actions.npy", "--look", look, "--output", folder / look],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    frames = folder / look / "frames"
    return {camera: np.asarray(Image.open(frames / f"first-{camera}.png")) for camera in CAMERAS}


def of_an_environment(**options: Any) -> Frames:
    environment = rollout_libero.Environment(
        TASK, init_states=STATE, orientation="upright", **options
    )
    observation, _ = environment.reset()
    environment.close()
    return {camera: observation[camera] for camera in CAMERAS}


def of_libero(**options: Any) -> Frames:
    suite = benchmark.get_benchmark("libero_object")()
    environment = OffScreenRenderEnv(
        bddl_file_name=suite.get_task_bddl_file_path(0),
        camera_heights=256, camera_widths=256, **options,
    )  # fmt: skip
    environment.reset()
    observation = environment.set_init_state(suite.get_task_init_states(0)[STATE])
    for _ in range(10):
        observation, *_ = environment.step(REST)
    environment.close()
    return {camera: observation[f"{camera}_image"][::-1] for camera in CAMERAS}


def test_every_way_to_a_scene_shows_the_same_two_looks(
    real_assets: Path, programs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROLLOUT_LOOK", raising=False)
    default, newer = native.LOOKS
    older_frames, newer_frames = (of_the_worker(look, programs, tmp_path) for look in native.LOOKS)
    # The floor fills most of the picture, and the newer look is darker.
    assert older_frames["agentview"].mean() > newer_frames["agentview"].mean() + 20
    for of in (of_an_environment, of_libero):
        np.testing.assert_equal(of(), older_frames)
        np.testing.assert_equal(of(look=newer), newer_frames)
        monkeypatch.setenv("ROLLOUT_LOOK", newer)
        np.testing.assert_equal(of(), newer_frames)
        np.testing.assert_equal(of(look=default), older_frames)
        monkeypatch.delenv("ROLLOUT_LOOK")


def test_an_unknown_look_is_refused_with_the_known_ones() -> None:
    known = r"look `bright`: valid are mujoco-3\.3\.2, mujoco-3\.3\.3"
    with pytest.raises(ValueError, match=known):
        of_an_environment(look="bright")
