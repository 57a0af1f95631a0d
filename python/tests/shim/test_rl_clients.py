"""Unmodified files of reinforcement-learning frameworks on the shim.

RLinf is installed with the other clients (`ROLLOUT_CLIENTS`, test_clients.py). The other frameworks
are in no package index: `ROLLOUT_FRAMEWORKS` names a folder with their checkouts, each named after
its repository."""

from __future__ import annotations

import os
import pickle
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import libero
import liberoplus
import rollout_libero
from libero.libero import benchmark
from libero.libero.envs import OffScreenRenderEnv

SCRIPT = Path(__file__).with_name("rl_rollouts.py")
SUITE, SIZE = "libero_spatial", 64


@pytest.fixture(scope="module")
def python() -> str:
    """The Python of an environment with PyTorch."""
    path = os.environ.get("ROLLOUT_CLIENTS")
    if not path or not Path(path).exists():
        pytest.skip("the clients are not installed: ROLLOUT_CLIENTS names no Python")
    return path


@pytest.fixture(scope="module")
def shim(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with only the packages under test."""
    folder = tmp_path_factory.mktemp("packages")
    for package in (rollout_libero, libero, liberoplus):
        (folder / package.__name__).symlink_to(Path(str(package.__file__)).parent)
    return folder


def roll_out(python: str, shim: Path, out: Path, framework: str, sources: Path | None) -> Any:
    environment = {
        **os.environ,
        "PYTHONPATH": str(shim),
        "LIBERO_CONFIG_PATH": str(out / "settings"),
        "FRAMEWORK_SOURCES": "" if sources is None else str(sources),
    }
    file = out / f"{framework}.pickle"
    done = subprocess.run(
        [python, str(SCRIPT), framework, str(file)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, f"{framework}: {done.stdout[-2000:]}{done.stderr[-4000:]}"
    with open(file, "rb") as pickled:
        return pickle.load(pickled)


def checkout(name: str) -> Path:
    folder = Path(os.environ.get("ROLLOUT_FRAMEWORKS") or "/nowhere") / name
    if not folder.is_dir():
        pytest.skip(f"there is no checkout of {name}: ROLLOUT_FRAMEWORKS names no folder with one")
    return folder


def rlinf(python: str, installation: str) -> Path | None:
    if installation == "checkout":
        return checkout("RLinf")
    if subprocess.run([python, "-c", "import rlinf"], capture_output=True, check=False).returncode:
        pytest.skip("RLinf is not among the clients")
    return None


def assert_same(ours: Any, theirs: Any, label: str) -> None:
    if isinstance(theirs, dict):
        assert list(ours) == list(theirs), label
        for key in theirs:
            assert_same(ours[key], theirs[key], f"{label}/{key}")
    elif isinstance(theirs, list | tuple):
        assert len(ours) == len(theirs), label
        for i, (our, their) in enumerate(zip(ours, theirs)):
            assert_same(our, their, f"{label}/{i}")
    else:
        assert type(ours) is type(theirs), label
        np.testing.assert_array_equal(ours, theirs, err_msg=label)


@pytest.mark.parametrize("installation", ["package", "checkout"])
@pytest.mark.parametrize(
    "kind", ["rlinf", "rlinf_auto_reset", "rlinf_evaluated", "rlinf_recorded", "rlinf_plus"]
)
def test_rlinf_in_one_process_equals_rlinfs_processes(
    kind: str, installation: str, python: str, shim: Path, tmp_path: Path
) -> None:
    sources = rlinf(python, installation)
    theirs = roll_out(python, shim, tmp_path, kind, sources)
    ours = roll_out(python, shim, tmp_path, f"{kind}_together", sources)
    assert ours["tasks"] == theirs["tasks"]
    # Two resets, each with an observation, and with results and a count for each of two chunks.
    assert len(theirs["outputs"]) == 10
    assert_same(ours["outputs"], theirs["outputs"], kind)
    print(f"{kind}: {theirs['seconds']:.1f} s in processes, {ours['seconds']:.1f} s in one process")


@pytest.mark.parametrize("installation", ["package", "checkout"])
def test_rlinf_runs_tasks_of_all_suites(
    installation: str, python: str, shim: Path, tmp_path: Path
) -> None:
    rollouts = roll_out(python, shim, tmp_path, "rlinf_of_130", rlinf(python, installation))
    instructions = {
        task.language
        for suite in benchmark.libero_suites
        for task in benchmark.task_maps[suite].values()
    }
    assert set(rollouts["tasks"]) <= instructions
    assert rollouts["outputs"][0]["main_images"].shape == (2, SIZE, SIZE, 3)


def test_simplevla_rl_rolls_out_in_a_forked_process(
    python: str, shim: Path, tmp_path: Path
) -> None:
    rollouts = roll_out(python, shim, tmp_path, "simplevla_rl", checkout("SimpleVLA-RL"))
    first, *steps = rollouts["outputs"]
    suite = benchmark.get_benchmark(SUITE)()
    env = OffScreenRenderEnv(
        bddl_file_name=suite.get_task_bddl_file_path(2), camera_heights=256, camera_widths=256
    )
    env.seed(0)
    env.reset()
    env.set_init_state(suite.get_task_init_states(2)[5])
    for _ in range(10):
        observation, *_ = env.step([0, 0, 0, 0, 0, 0, -1])
    assert_same(first["obs"], dict(observation), "first")
    assert first["task_description"] == suite.get_task(2).language
    assert [step["finish_step"] for step in steps] == [8, 16, 24]
    assert [step["active"] for step in steps] == [True, True, False]
    rng = np.random.default_rng(4)
    for step in steps:
        for action in rng.uniform(-1, 1, (8, 7)):
            # The framework's own functions make the gripper binary and invert it.
            action[-1] = -np.sign(2 * action[-1] - 1)
            observation, *_ = env.step(action.tolist())
        assert_same(step["obs"], dict(observation), "step")
    env.close()


@pytest.mark.parametrize(
    ("framework", "name"), [("verl_vla", "verl-vla"), ("vlarl", "vlarl"), ("siirl", "siiRL")]
)
def test_a_frameworks_several_environments_equal_the_shims(
    framework: str, name: str, python: str, shim: Path, tmp_path: Path
) -> None:
    rollouts = roll_out(python, shim, tmp_path, framework, checkout(name))
    initial, observations, rewards, dones, infos = rollouts["outputs"]
    suite = benchmark.get_benchmark(SUITE)()
    moves = np.random.default_rng(4).uniform(-1, 1, (3, 2, 7))
    tasks = [(0, 1), (3, 2)]
    for row, (task, state) in enumerate(tasks):
        env = OffScreenRenderEnv(
            bddl_file_name=suite.get_task_bddl_file_path(task),
            camera_heights=SIZE,
            camera_widths=SIZE,
        )
        env.seed(4 + row)
        env.reset()
        observation = env.set_init_state(suite.get_task_init_states(task)[state])
        assert_same(dict(initial[row]), dict(observation), f"{framework} {row}")
        for action in moves[:, row]:
            observation, *_ = env.step(action.tolist())
        if row == 0:
            assert_same(dict(observations[0]), dict(observation), framework)
        elif framework != "verl_vla":
            env.reset()
            env.set_init_state(suite.get_task_init_states(task)[4])
            observation, *_ = env.step([0.0] * 6 + [-1.0])
            assert_same(dict(observations[1]), dict(observation), f"{framework} renewed")
        env.close()
    if framework == "verl_vla":
        env = OffScreenRenderEnv(
            bddl_file_name=suite.get_task_bddl_file_path(5), camera_heights=SIZE, camera_widths=SIZE
        )
        env.seed(9)
        env.reset()
        env.set_init_state(suite.get_task_init_states(5)[4])
        observation, *_ = env.step([0.0] * 6 + [-1.0])
        assert_same(dict(observations[1]), dict(observation), "another task")
        env.close()
    assert rewards.tolist() == [0.0, 0.0] and dones.tolist() == [False, False]
    assert infos == [{"env_id": 0}, {"env_id": 1}]


def test_ript_wraps_one_environment_and_several(python: str, shim: Path, tmp_path: Path) -> None:
    rollouts = roll_out(python, shim, tmp_path, "ript_vla", checkout("ript-vla"))
    alone, several = rollouts["outputs"][:4], rollouts["outputs"][4:]
    # `reset_ori` returns an observation from before it sets the states; `reset` sets them first.
    for count, (first, stepped, reset, again) in ((1, alone), (2, several)):
        assert first["agentview_rgb"].shape == (count, SIZE, SIZE, 3)
        assert reset["gripper_states"].shape == (count, 2)
        for observation, reward, terminated, truncated, info in (stepped, again):
            assert observation["agentview_rgb"].shape == (count, SIZE, SIZE, 3)
            assert reward.shape == terminated.shape == truncated.shape == (count,)
            assert [env_info["success"] for env_info in info] == [False] * count
