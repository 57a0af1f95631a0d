"""Unmodified PyPI clients of LIBERO on the shim. Each client plays an episode in which the robot
drops an object into a basket, and the task succeeds. If the original is installed, the episode
succeeds with it, too, at most two steps earlier or later; frames are nearly equal until the gripper
touches something, and similar afterwards.

`ROLLOUT_CLIENTS` names the Python of an environment with the clients and the packages of
clients.txt (`cargo xtask test` creates the environment if it can). If `ROLLOUT_ORIGINAL` has the
same version of Python, it also imports the clients from that environment."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frames import RENDERED_HERE, assert_close_frames
from original import original_python, packages, printed_by, run, run_original
from reference import put_into_basket

from libero.libero import benchmark
from libero.libero.envs import OffScreenRenderEnv

CLIENTS = ["vla-eval", "lerobot", "torchrl"]
SUITE, TASK = "libero_object", 0
# Number of steps before the gripper touches anything.
UNTOUCHED = 34
# Grasps amplify rounding errors, so success may come this number of steps earlier or later.
SUCCESS_STEPS = 2


@pytest.fixture(scope="module")
def actions(tmp_path_factory: pytest.TempPathFactory, real_assets: Path) -> Path:
    """Actions [steps, 7] that put the task's object into the basket. A script that
    knows the positions of object and basket computes the actions."""
    suite = benchmark.get_benchmark_dict()[SUITE]()
    env = OffScreenRenderEnv(
        bddl_file_name=suite.get_task_bddl_file_path(TASK), use_camera_obs=False
    )
    env.seed(7)
    env.reset()
    env.set_init_state(suite.get_task_init_states(TASK)[0])
    for _ in range(10):
        observation, *_ = env.step([0.0] * 6 + [-1.0])
    episode = list(put_into_basket(env, observation))
    _, (_, _, done, _) = episode[-1]
    assert done, "the script did not put the object into the basket"
    env.close()
    path = tmp_path_factory.mktemp("episode") / "actions.npy"
    np.save(path, np.array([action for action, _ in episode]))
    return path


@pytest.mark.parametrize("client", CLIENTS)
def test_a_client_gets_the_same_episode_as_with_the_original(
    client: str, clients: str, actions: Path, shim: Path, tmp_path: Path
) -> None:
    # vla-eval and torchrl write or need a configuration of LIBERO, so they get a new folder for it.
    ours = run(
        clients,
        "client_episodes.py",
        client,
        str(actions),
        PYTHONPATH=str(shim),
        LIBERO_CONFIG_PATH=str(tmp_path / "settings"),
    )
    assert succeeded(ours[-1]) or succeeded(ours[-2])
    assert not succeeded(ours[len(ours) // 2])
    # The gripper opens above the basket after 105 steps, so an episode of 90 steps ended too early.
    assert len(ours) > 90

    if version(clients) != version(original_python()):
        pytest.skip("the original and the clients are of different versions of Python")
    theirs = run_original(
        "client_episodes.py", client, str(actions), CLIENT_PACKAGES=packages(clients)
    )
    assert abs(len(ours) - len(theirs)) <= SUCCESS_STEPS
    assert [list(step) for step in ours[:90]] == [list(step) for step in theirs[:90]]
    # Until the gripper touches something, frames and readings differ by roundings at most. Later,
    # rounding errors grow, in the original as well, and frames are only similar.
    for i in range(UNTOUCHED):
        assert_same(ours[i], theirs[i], f"{client} step {i}")
    for i in range(UNTOUCHED, min(len(ours), len(theirs))):
        assert_alike(ours[i], theirs[i], f"{client} step {i}")
    assert succeeded(theirs[-1]) or succeeded(theirs[-2])


def assert_same(our: Any, their: Any, label: str) -> None:
    if isinstance(their, dict):
        assert list(our) == list(their), label
        for key in their:
            assert_same(our[key], their[key], f"{label}: {key}")
    elif isinstance(their, np.ndarray) and their.dtype == np.uint8:
        channels = -1 if their.shape[-1] == 3 else 0
        our, their = (np.moveaxis(frame, channels, -1) for frame in (our, their))
        assert_close_frames(our, their, label, RENDERED_HERE)
    elif isinstance(their, np.ndarray) and their.dtype.kind == "f":
        assert our.dtype == their.dtype, label
        tolerance = 1e-9 if their.dtype == np.float64 else 1e-6
        np.testing.assert_allclose(our, their, rtol=0, atol=tolerance, err_msg=label)
    else:
        np.testing.assert_array_equal(our, their, err_msg=label)


def assert_alike(our: Any, their: Any, label: str) -> None:
    """Checks that 99.5 % of the values of each frame are equal to within 16 of 255 levels."""
    if isinstance(their, dict):
        for key in their:
            assert_alike(our[key], their[key], f"{label}: {key}")
    elif isinstance(their, np.ndarray) and their.dtype == np.uint8:
        share = (np.abs(our.astype(int) - their.astype(int)) <= 16).mean()
        assert share >= 0.995, f"{label}: {share:.2%} of the values are nearly equal"


def succeeded(step: dict[str, Any]) -> bool:
    return bool(np.any(step.get("success", step.get("is_success", False))))


def version(python: str) -> str:
    return printed_by(python, "import sys; print(sys.version_info[:2])")
