"""Environments in one process, with the methods of RLinf's environments, each of which runs in a
process of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rollout_libero.training import Start, TrainingEnvironment

Frames = dict[str, NDArray[np.uint8]]
"""Frames of one environment by key; pixel row 0 is the bottom."""

_CAMERAS = {"agentview": "agentview_image", "robot0_eye_in_hand": "robot0_eye_in_hand_image"}
_READINGS = {
    "eef_pos": "robot0_eef_pos",
    "eef_quat": "robot0_eef_quat",
    "gripper_pos": "robot0_gripper_qpos",
    "gripper_vel": "robot0_gripper_qvel",
    "joint_pos": "robot0_joint_pos",
    "joint_vel": "robot0_joint_vel",
}


class Rows:
    """Environments with the methods of ``ReconfigureSubprocEnv`` that RLinf calls."""

    is_async = False

    def __init__(
        self, parameters: Sequence[dict[str, Any]], *, threads: int, draws_all: bool
    ) -> None:
        heights = {each.get("camera_heights", 128) for each in parameters}
        widths = {each.get("camera_widths", 128) for each in parameters}
        if len(heights) != 1 or len(widths) != 1:
            raise ValueError(
                f"failed to make frames of {sorted(heights)} × {sorted(widths)} pixels: give all "
                "environments one size"
            )
        self.env_num = len(parameters)
        self._size = (widths.pop(), heights.pop())
        # True if the frames of every step of a chunk are rendered, not only those of the last.
        self._draws_all = draws_all
        self._pool = ThreadPoolExecutor(threads)
        self._files = [str(each["bddl_file_name"]) for each in parameters]
        self._seeds = [int(each["seed"]) for each in parameters]
        # Number of the original's model loads per environment; its samplers draw at each load.
        self._loads = [1] * self.env_num
        self._chunk: _Chunk | None = None
        self._rows = TrainingEnvironment(
            self.env_num,
            assets_of_libero(),
            threads=threads,
            cameras=list(_CAMERAS),
            width=self._size[0],
            height=self._size[1],
            settle_steps=0,
        )

    def __len__(self) -> int:
        return self.env_num

    def reconfigure_env_fns(self, env_fns: Sequence[dict[str, Any]], id: Any = None) -> None:
        """Assigns tasks and seeds to environments, as the constructor does."""
        for row, parameters in zip(self._ids(id), env_fns, strict=True):
            self._files[row] = str(parameters["bddl_file_name"])
            self._seeds[row] = int(parameters["seed"])
            self._loads[row] = 1

    def seed(self, seed: int | Sequence[int]) -> list[None]:
        """Seeds all environments, with consecutive seeds if one number is given."""
        if isinstance(seed, int | np.integer):
            seed = [int(seed) + row for row in range(self.env_num)]
        self._seeds = [int(number) for number in seed]
        return [None] * self.env_num

    def reset(self, id: Any = None) -> NDArray[np.object_]:
        """Resets environments; the samplers place all objects."""
        rows = self._ids(id)
        for row in rows:
            self._loads[row] += 1
        return self._begin(rows, [None] * len(rows))

    def set_init_state(self, init_state: Any, id: Any = None) -> NDArray[np.object_]:
        """Starts environments from initial states, after a reset."""
        return self._begin(self._ids(id), init_state)

    def step(self, action: Any, id: Any = None) -> Any:
        """Executes one control step, or returns the next step of the simulated chunk."""
        if self._chunk is not None and self._chunk.has_next and id is None:
            observations, success = self._chunk.next()
            rows = list(range(self.env_num))
        else:
            rows = self._ids(id)
            stepped = self._rows.step_chunk(as_array(action)[:, None], rows, render="none")
            success = stepped.success[:, 0]
            self._draw_numbers(rows, 1)
            observations = self._observed(stepped.observation, rows)
        infos = np.array([{"env_id": row} for row in rows], dtype=object)
        return observations, success.astype(np.float64), success.copy(), infos

    def chunk(self, actions: NDArray[np.float64]) -> _Chunk:
        """Simulates a whole chunk, [environments, steps, 7]. Within the returned context, ``step``
        returns the steps of this chunk. If all frames are rendered, nothing is simulated here, and
        ``step`` simulates each step."""
        if self._draws_all:
            return _Chunk(self, None)
        stepped = self._rows.step_chunk(actions)
        rows = self._ids(None)
        self._draw_numbers(rows, actions.shape[1])
        last = _objects([self._observation(stepped.observation, at) for at in rows])
        return _Chunk(self, (last, stepped.success))

    def check_success(self) -> list[bool]:
        """Returns for each environment True if its goal holds."""
        return [self._simulation(row).success() for row in self._ids(None)]

    def get_sim_state(self) -> list[NDArray[np.float64]]:
        return [self._simulation(row).state() for row in self._ids(None)]

    def close(self) -> None:
        self._rows.close()
        self._pool.shutdown()

    def _begin(self, rows: list[int], states: Any) -> NDArray[np.object_]:
        starts = [
            Start(
                self._files[row],
                None if state is None else np.asarray(state, dtype=np.float64),
                seed=self._seeds[row],
                loads=self._loads[row],
            )
            for row, state in zip(rows, states, strict=True)
        ]
        return self._observed(self._rows.reset(starts, rows, render="none"), rows)

    def _observed(self, readings: dict[str, Any], rows: list[int]) -> NDArray[np.object_]:
        """Returns observations. When a frame is first read, the frames of all rows are rendered on
        threads."""
        instant = _Instant(
            [self._simulation(row).capture() for row in rows],
            [self._frame_change(row) for row in rows],
            self._size,
            self._pool.map,
        )
        return _objects(
            [_LazyObservation(_readings(readings, at), instant, at) for at in range(len(rows))]
        )

    def _observation(self, observation: dict[str, Any], at: int) -> dict[str, Any]:
        """Returns one row of an observation, with RLinf's keys and LIBERO's order of pixels."""
        frames = {key: observation[camera][at, ::-1, ::-1] for camera, key in _CAMERAS.items()}
        return {**self._frame_change(at)(frames), **_readings(observation, at)}

    def _draw_numbers(self, rows: list[int], steps: int) -> None:
        """Draws the random numbers for the corruption of the frames of the rows' steps. LIBERO's
        frames are not corrupted."""

    def _frame_change(self, row: int) -> Callable[[Frames], Frames]:
        """Returns the function that corrupts the frames of a row's last step. LIBERO's frames are
        not corrupted."""
        return lambda frames: frames

    def _simulation(self, row: int) -> Any:
        return self._rows._simulation(row)

    def _ids(self, id: Any) -> list[int]:
        if id is None:
            return list(range(self.env_num))
        return [int(row) for row in np.atleast_1d(id)]


class _Chunk:
    """Steps of a simulated chunk, returned one after another."""

    def __init__(self, rows: Rows, results: tuple[Any, NDArray[np.bool_]] | None) -> None:
        self._rows = rows
        self._results = results
        self._returned_steps = 0

    @property
    def has_next(self) -> bool:
        """True if the chunk has steps that are not returned yet."""
        return self._results is not None and self._returned_steps < self._results[1].shape[1]

    def next(self) -> tuple[Any, NDArray[np.bool_]]:
        """Returns the next step's observations (None before the last step) and success."""
        assert self._results is not None
        last, success = self._results
        self._returned_steps += 1
        return (None if self.has_next else last), success[:, self._returned_steps - 1]

    def __enter__(self) -> None:
        self._rows._chunk = self

    def __exit__(self, *_error: Any) -> None:
        self._rows._chunk = None


class _Instant:
    """The rows' observations at one instant. All frames are rendered together, once."""

    def __init__(
        self,
        views: list[Any],
        frame_changes: list[Callable[[Frames], Frames]],
        size: tuple[int, int],
        parallel_map: Callable[..., Any],
    ) -> None:
        self._views = views
        self._frame_changes = frame_changes
        self._size = size
        self._parallel_map = parallel_map
        self._frames: list[Frames] | None = None

    def frames(self, at: int) -> Frames:
        if self._frames is None:
            self._frames = list(self._parallel_map(self._draw, self._views, self._frame_changes))
        return self._frames[at]

    def _draw(self, view: Any, change: Callable[[Frames], Frames]) -> Frames:
        return change({key: view.frame(camera, *self._size) for camera, key in _CAMERAS.items()})


class _LazyObservation(dict[str, Any]):
    """An observation whose frames are rendered when they are first read."""

    def __init__(self, readings: dict[str, Any], instant: _Instant, at: int) -> None:
        super().__init__(readings)
        self._instant, self._at = instant, at

    def __missing__(self, name: str) -> Any:
        if name not in _CAMERAS.values():
            raise KeyError(name)
        self.update(self._instant.frames(self._at))
        return self[name]


def _readings(readings: dict[str, Any], at: int) -> dict[str, Any]:
    """Returns the readings of one row, with RLinf's keys. They are copies, because RLinf writes
    into the quaternion."""
    return {key: readings[name][at].copy() for name, key in _READINGS.items()}


def _objects(observations: list[Any]) -> NDArray[np.object_]:
    array = np.empty(len(observations), dtype=object)
    array[:] = observations
    return array


def as_array(actions: Any) -> NDArray[np.float64]:
    """Converts actions to an array of float64. A tensor of PyTorch may be on any device."""
    if hasattr(actions, "detach"):
        actions = actions.detach().cpu().numpy()
    return np.asarray(actions, dtype=np.float64)


def assets_of_libero() -> str | None:
    """Returns the asset pack that the package ``libero`` uses; None without that package."""
    try:
        from libero.libero import get_assets_path
    except ImportError:
        return None
    path: str = get_assets_path()
    return path
