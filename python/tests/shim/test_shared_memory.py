"""Frames that the processes of `SubprocVectorEnv` pass through shared memory."""

import multiprocessing
import os
import pickle
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from libero.libero import benchmark
from libero.libero.envs import DummyVectorEnv, OffScreenRenderEnv, SubprocVectorEnv, _shared_memory
from libero.libero.envs._shared_memory import SIZE, SharedMemory

FRAME = (256, 256, 3)


def frame_environment() -> Any:
    """Returns a class of environments whose observations are frames with the number of steps. The
    class is local, so that spawned processes need not import this module."""

    class FrameEnvironment:
        def __init__(self) -> None:
            self.steps = 0

        def _observation(self) -> dict[str, Any]:
            frame = np.full(FRAME, self.steps, np.uint8)
            return {"frame": frame, "again": frame, "small": np.array([self.steps])}

        def reset(self) -> dict[str, Any]:
            self.steps = 0
            return self._observation()

        def step(self, action: Any) -> Any:
            self.steps += 1
            return self._observation(), 0.0, False, {}

        def close(self) -> None:
            pass

    return FrameEnvironment


@pytest.fixture(params=["fork", "spawn", "forkserver"])
def start_method(request: Any) -> Iterator[str]:
    """Sets the method that starts processes."""
    before = multiprocessing.get_start_method(allow_none=True)
    multiprocessing.set_start_method(request.param, force=True)
    yield request.param
    multiprocessing.set_start_method(before, force=True)


def test_observations_outlive_the_next_step(start_method: str) -> None:
    envs = SubprocVectorEnv([frame_environment()] * 2)
    first = envs.reset()
    second, *_ = envs.step([0.0] * 2)
    third, *_ = envs.step([0.0], id=[1])
    for observation, number in ((first[0], 0), (first[1], 0), (second[0], 1), (third[0], 2)):
        frame = observation["frame"]
        assert frame.shape == FRAME and frame.dtype == np.uint8
        assert (frame == number).all() and observation["small"] == number
        assert observation["again"] is frame
        assert frame.flags.owndata and frame.flags.writeable
    envs.close()


def test_messages_hold_no_frames() -> None:
    memory = SharedMemory()
    frames = {name: np.full(FRAME, number, np.uint8) for number, name in enumerate("ab")}
    message = memory.dumps((frames, 1.0, False, {}))
    assert len(message) < 1024
    (received, *others) = pickle.loads(message)
    assert others == [1.0, False, {}]
    for name, frame in frames.items():
        np.testing.assert_array_equal(received[name], frame)
    memory.close_descriptor()


@pytest.mark.parametrize(
    "array",
    [
        np.zeros(SIZE + 1, np.uint8),
        np.arange(90_000).reshape(300, 300)[:, ::2],
        np.array([{"any": "object"}] * 9_000),
    ],
    ids=["too large", "not contiguous", "objects"],
)
def test_other_arrays_stay_in_the_message(array: Any) -> None:
    memory = SharedMemory()
    message = memory.dumps([array, np.ones(FRAME)])
    assert len(message) > 9_000
    received, frame = pickle.loads(message)
    np.testing.assert_array_equal(received, array)
    np.testing.assert_array_equal(frame, np.ones(FRAME))
    memory.close_descriptor()


def test_arrays_beyond_the_memory_stay_in_the_message() -> None:
    memory = SharedMemory()
    arrays = [np.full(SIZE // 2, number, np.uint8) for number in range(3)]
    received = pickle.loads(memory.dumps(arrays))
    for received_array, array in zip(received, arrays):
        np.testing.assert_array_equal(received_array, array)
    memory.close_descriptor()


def test_environments_close_their_descriptors() -> None:
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(3):
        envs = SubprocVectorEnv([frame_environment()] * 2)
        envs.reset()
        envs.close()
        del envs
    assert len(os.listdir("/proc/self/fd")) <= before + 1


@pytest.mark.parametrize("is_shared", [True, False])
def test_frames_from_processes_equal_frames_of_one_process(
    is_shared: bool, bddl_file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not is_shared:
        monkeypatch.setattr(_shared_memory, "create", lambda: None)

    def construct() -> OffScreenRenderEnv:
        return OffScreenRenderEnv(bddl_file_name=bddl_file, camera_heights=96, camera_widths=96)

    states = benchmark.get_benchmark("libero_goal")().get_task_init_states(8)[:1]
    observations: list[Any] = []
    for kind in (DummyVectorEnv, SubprocVectorEnv):
        # Several environments of one process would share NumPy's generator.
        envs = kind([construct])
        envs.seed(3)
        observations += [envs.reset()[0], envs.set_init_state(states)[0]]
        observations.append(envs.step([[0.5, 0, 0, 0, 0, 0, -1]])[0][0])
        envs.close()
    for alone, sent in zip(observations[:3], observations[3:]):
        assert list(sent) == list(alone)
        for name, value in alone.items():
            np.testing.assert_array_equal(sent[name], value)
            assert sent[name].dtype == value.dtype
