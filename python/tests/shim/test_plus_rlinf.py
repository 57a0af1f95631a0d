"""LIBERO-Plus in one process, called as RLinf calls environments in subprocesses. Rollouts must
equal those of `liberoplus` environments that each have their own global generator."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("liberoplus", reason="rollout-libero-shim is not installed")

from liberoplus.liberoplus import get_libero_path
from liberoplus.liberoplus.envs import OffScreenRenderEnv
from rollout_libero._rlinf_plus import PlusRows

pytestmark = pytest.mark.usefixtures("plus_files")

SIZE = 32
BOWL = "put_the_bowl_on_the_plate"
NAMES = (
    f"{BOWL}_view_0_0_100_0_0_initstate_0_noise_39",
    f"{BOWL}_view_0_0_100_0_0_initstate_409",
    f"{BOWL}_view_0_0_100_0_0_initstate_0_noise_50",
    f"{BOWL}_moved_level1_sample1",
)
KEYS = (
    "agentview_image",
    "robot0_eye_in_hand_image",
    "robot0_eef_pos",
    "robot0_eef_quat",
    "robot0_gripper_qpos",
)
ZERO = np.zeros(7)


def parameters(name: str, seed: int = 0) -> dict[str, Any]:
    file = f"{get_libero_path('bddl_files')}/libero_goal/{name}.bddl"
    return {"bddl_file_name": file, "camera_heights": SIZE, "camera_widths": SIZE, "seed": seed}


class Process:
    """An environment with a global generator of its own, as if it were in a separate process."""

    def __init__(self, name: str, seed: int = 0) -> None:
        arguments = parameters(name)
        del arguments["seed"]
        self.env = OffScreenRenderEnv(**arguments)
        self._state: Any = None
        self.call("seed", seed)

    def call(self, name: str, *arguments: Any) -> Any:
        """Calls a method of the environment while the global generator has the environment's
        state."""
        outside = np.random.get_state()
        if self._state is not None:
            np.random.set_state(self._state)
        result = getattr(self.env, name)(*arguments)
        self._state = np.random.get_state()
        np.random.set_state(outside)
        return result


@pytest.fixture(params=[False, True], ids=["last", "all"])
def rows(request: pytest.FixtureRequest) -> Iterator[PlusRows]:
    """Environments in one process that render either the last step of a chunk or every step."""
    environments = PlusRows(
        [parameters(name) for name in NAMES], threads=2, draws_all=request.param
    )
    yield environments
    environments.close()


def assert_same(ours: Any, theirs: Any, label: str) -> None:
    for key in KEYS:
        np.testing.assert_array_equal(ours[key], theirs[key], err_msg=f"{label}: {key}")


def test_rollouts_equal_those_in_processes(rows: PlusRows) -> None:
    processes = [Process(name) for name in NAMES]
    all_ids = list(range(len(NAMES)))

    def reset(ids: list[int], seed: int) -> None:
        """Imitates RLinf's `_reconfigure` and waiting steps, in one process and in processes: seeds
        all environments, resets the environments `ids`, and steps these twice."""
        rows.seed(seed)
        for i, process in enumerate(processes):
            process.call("seed", seed + i)
        ours = rows.reset(id=ids)
        for index, i in enumerate(ids):
            assert_same(ours[index], processes[i].call("reset"), f"reset of {i}")
        for _ in range(2):
            ours, _, _, infos = rows.step(np.zeros((len(ids), 7)), ids)
            assert [info["env_id"] for info in infos] == ids
            for index, i in enumerate(ids):
                assert_same(ours[index], processes[i].call("step", ZERO)[0], f"wait of {i}")

    def chunk(number: int) -> None:
        actions = np.random.default_rng(number).uniform(-1, 1, (len(NAMES), 3, 7))
        with rows.chunk(actions):
            for step in range(3):
                ours, _, success, _ = rows.step(actions[:, step])
                for i, process in enumerate(processes):
                    theirs, _, theirs_success, _ = process.call("step", actions[i, step])
                    assert success[i] == theirs_success
                    if ours is not None:
                        assert_same(ours[i], theirs, f"chunk {number}, step {step} of {i}")
        assert ours is not None
        for ours_state, process in zip(rows.get_sim_state(), processes):
            np.testing.assert_array_equal(ours_state, process.env.get_sim_state())

    reset(all_ids, 11)
    chunk(0)
    # Some environments are reset automatically, while the rollouts of the others continue.
    reset([3, 0], 22)
    chunk(1)
    # One row gets a different variant.
    variant = f"{BOWL}_view_0_0_181_0_0_initstate_0"
    rows.reconfigure_env_fns([parameters(variant, 5)], [2])
    processes[2] = Process(variant, 5)
    reset([2], 33)
    chunk(2)
    for process in processes:
        process.env.close()


def test_initial_states_equal_those_in_processes(rows: PlusRows) -> None:
    processes = [Process(name) for name in NAMES]
    rows.seed(4)
    rows.reset()
    state = rows.get_sim_state()[0].copy()
    state[1:3] += 0.1
    ours = rows.set_init_state([state, state], id=[0, 1])
    for i in (0, 1):
        processes[i].call("seed", 4 + i)
        processes[i].call("reset")
        assert_same(ours[i], processes[i].call("set_init_state", state), f"state of {i}")
    ours, *_ = rows.step(np.zeros((2, 7)), [0, 1])
    for i in (0, 1):
        assert_same(ours[i], processes[i].call("step", ZERO)[0], f"step of {i}")


def test_calls_before_a_reset_are_refused(rows: PlusRows) -> None:
    for use in (
        lambda: rows.step(np.zeros((1, 7)), [0]),
        lambda: rows.set_init_state([np.zeros(3)], [0]),
        rows.get_sim_state,
        rows.check_success,
    ):
        with pytest.raises(ValueError, match="row 0: it has no rollout; call reset"):
            use()


def test_variants_with_missing_files_are_refused(rows: PlusRows) -> None:
    rows.reconfigure_env_fns([parameters(f"{BOWL}_light_1")], [1])
    with pytest.raises(FileNotFoundError, match="scenes/lights/"):
        rows.reset()
