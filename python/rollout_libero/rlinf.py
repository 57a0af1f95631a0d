"""RLinf's LIBERO environments in one process: ``export RLINF_EXT_MODULE=rollout_libero.rlinf``.

RLinf imports the module that this variable names in each of its workers and calls
``register``. RLinf's ``LiberoEnv`` still chooses tasks and initial states, computes rewards and
metrics, truncates and resets; only the simulation below it is replaced. RLinf itself starts a
process for each environment, which renders and sends every observation. Here, threads of the worker
simulate, and render only the last observation of each chunk, which is the policy's input.

If a run saves videos or collects data, every step is rendered, which is slow: set
``save_video: False`` for training.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rollout_libero.training import Start, TrainingEnvironment

_CAMERAS = {"agentview": "agentview_image", "robot0_eye_in_hand": "robot0_eye_in_hand_image"}
_READINGS = {
    "eef_pos": "robot0_eef_pos",
    "eef_quat": "robot0_eef_quat",
    "gripper_pos": "robot0_gripper_qpos",
    "gripper_vel": "robot0_gripper_qvel",
    "joint_pos": "robot0_joint_pos",
    "joint_vel": "robot0_joint_vel",
}
_PARAMETERS = {"bddl_file_name", "camera_heights", "camera_widths", "seed"}


def register() -> None:
    """Replaces RLinf's ``LiberoEnv``. A second call has no effect."""
    if os.environ.get("LIBERO_TYPE", "standard").lower() != "standard":
        print(
            "rollout_libero.rlinf: LIBERO_TYPE is not standard, so RLinf's own processes simulate"
        )
        return
    from rlinf.envs.libero import libero_env

    if not getattr(libero_env.LiberoEnv, "is_together", False):
        libero_env.LiberoEnv = together(libero_env.LiberoEnv)


def together(base: Any) -> Any:
    """Returns a subclass of RLinf's ``LiberoEnv`` that simulates in one process."""

    class LiberoEnv(base):  # type: ignore[misc]
        """RLinf's LIBERO, simulated by ``rollout_libero``."""

        is_together = True

        def _init_env(self) -> None:
            parameters = self.get_env_fn_params()
            unknown = {name for of_env in parameters for name in of_env} - _PARAMETERS
            if unknown:
                raise ValueError(
                    f"env.init_params has {', '.join(sorted(unknown))}, which rollout_libero.rlinf "
                    "does not support: leave it out, or unset RLINF_EXT_MODULE"
                )
            draws_all = _is_recorded(self.cfg)
            if draws_all:
                print(
                    "rollout_libero.rlinf: videos are saved or data is collected, so every step is "
                    "rendered: set video_cfg.save_video to False for speed"
                )
            self.env = Rows(parameters, threads=_threads(), draws_all=draws_all)

        def chunk_step(self, chunk_actions: Any) -> Any:
            with self.env.chunk(_as_array(chunk_actions)):
                return super().chunk_step(chunk_actions)

        def _wrap_obs(self, obs_list: Any) -> Any:
            # RLinf reads the last observation of a chunk, and skips None.
            return None if obs_list is None else super()._wrap_obs(obs_list)

    LiberoEnv.__qualname__ = LiberoEnv.__name__
    LiberoEnv.__module__ = base.__module__
    return LiberoEnv


class Rows:
    """Environments with the methods of ``ReconfigureSubprocEnv`` that RLinf calls."""

    is_async = False

    def __init__(
        self, parameters: Sequence[dict[str, Any]], *, threads: int, draws_all: bool
    ) -> None:
        heights = {of_env.get("camera_heights", 128) for of_env in parameters}
        widths = {of_env.get("camera_widths", 128) for of_env in parameters}
        if len(heights) != 1 or len(widths) != 1:
            raise ValueError(
                f"failed to make frames of {sorted(heights)} × {sorted(widths)} pixels: give all "
                "environments one size"
            )
        self.env_num = len(parameters)
        self._size = (widths.pop(), heights.pop())
        self._draws_all = draws_all
        self._pool = ThreadPoolExecutor(threads)
        self._files = [str(of_env["bddl_file_name"]) for of_env in parameters]
        self._seeds = [int(of_env["seed"]) for of_env in parameters]
        # Number of the original's model loads per environment; its samplers draw at each load.
        self._loads = [1] * self.env_num
        self._chunk: _Chunk | None = None
        self._rows = TrainingEnvironment(
            self.env_num,
            _assets(),
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
        if self._chunk is not None and self._chunk.is_left and id is None:
            observations, success = self._chunk.next()
            rows = list(range(self.env_num))
        else:
            rows = self._ids(id)
            stepped = self._rows.step_chunk(_as_array(action)[:, None], rows, render="none")
            success = stepped.success[:, 0]
            observations = self._observed(stepped.observation, rows)
        infos = np.array([{"env_id": row} for row in rows], dtype=object)
        return observations, success.astype(np.float64), success.copy(), infos

    def chunk(self, actions: NDArray[np.float64]) -> _Chunk:
        """Simulates a whole chunk, [environments, steps, 7]; ``step`` returns
        its steps within the context."""
        if self._draws_all:
            return _Chunk(self, None)
        stepped = self._rows.step_chunk(actions)
        rows = range(self.env_num)
        last = _objects([self._drawn(stepped.observation, at) for at in rows])
        return _Chunk(self, (last, stepped.success))

    def check_success(self) -> list[bool]:
        """Returns for each environment True if its goal holds."""
        return [simulation.success() for simulation in self._simulations()]

    def get_sim_state(self) -> list[NDArray[np.float64]]:
        """Returns the simulator state of each environment."""
        return [simulation.state() for simulation in self._simulations()]

    def close(self) -> None:
        """Closes all environments and the threads."""
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
        """Returns observations; reading the first frame renders the frames of all on threads."""
        instant = _Instant(
            [self._rows.simulations[row].look() for row in rows],  # type: ignore[union-attr]
            self._size,
            self._pool.map,
        )
        return _objects(
            [_LazyObservation(_named(readings, at), instant, at) for at in range(len(rows))]
        )

    def _drawn(self, observation: dict[str, Any], at: int) -> dict[str, Any]:
        frames = {key: observation[camera][at, ::-1, ::-1] for camera, key in _CAMERAS.items()}
        return {**frames, **_named(observation, at)}

    def _simulations(self) -> list[Any]:
        return [simulation for simulation in self._rows.simulations if simulation is not None]

    def _ids(self, id: Any) -> list[int]:
        if id is None:
            return list(range(self.env_num))
        return [int(row) for row in np.atleast_1d(id)]


class _Chunk:
    """Steps of a simulated chunk, returned one after another."""

    def __init__(self, rows: Rows, results: tuple[Any, NDArray[np.bool_]] | None) -> None:
        self._rows = rows
        self._results = results
        self._taken = 0

    @property
    def is_left(self) -> bool:
        """True if the chunk has further steps."""
        return self._results is not None and self._taken < self._results[1].shape[1]

    def next(self) -> tuple[Any, NDArray[np.bool_]]:
        """Returns the next step's observations (None before the last step) and success."""
        assert self._results is not None
        last, success = self._results
        self._taken += 1
        return (None if self.is_left else last), success[:, self._taken - 1]

    def __enter__(self) -> None:
        self._rows._chunk = self

    def __exit__(self, *_error: Any) -> None:
        self._rows._chunk = None


class _Instant:
    """Observations of all environments at one instant, rendered once."""

    def __init__(
        self, looks: list[Any], size: tuple[int, int], parallel_map: Callable[..., Any]
    ) -> None:
        self._looks = looks
        self._size = size
        self._parallel_map = parallel_map
        self._frames: list[dict[str, Any]] | None = None

    def frames(self, at: int) -> dict[str, Any]:
        """Returns an environment's frames."""
        if self._frames is None:
            self._frames = list(self._parallel_map(self._draw, self._looks))
        return self._frames[at]

    def _draw(self, look: Any) -> dict[str, Any]:
        return {key: look.frame(camera, *self._size) for camera, key in _CAMERAS.items()}


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


def _named(readings: dict[str, Any], at: int) -> dict[str, Any]:
    # Copies, because RLinf writes into a quaternion.
    return {key: readings[name][at].copy() for name, key in _READINGS.items()}


def _objects(observations: list[Any]) -> NDArray[np.object_]:
    array = np.empty(len(observations), dtype=object)
    array[:] = observations
    return array


def _as_array(actions: Any) -> NDArray[np.float64]:
    if hasattr(actions, "detach"):
        actions = actions.detach().cpu().numpy()
    return np.asarray(actions, dtype=np.float64)


def _is_recorded(cfg: Any) -> bool:
    """Returns True if every step's observation is recorded, in a video or as collected data."""
    video, data = cfg.get("video_cfg"), cfg.get("data_collection")
    return bool(
        (video is not None and video.get("save_video"))
        or (data is not None and data.get("enabled"))
    )


def _threads() -> int:
    """Returns one worker's share of the machine's cores."""
    workers = max(1, int(os.environ.get("NODE_LOCAL_WORLD_SIZE") or 1))
    return max(1, len(os.sched_getaffinity(0)) // workers)


def _assets() -> str | None:
    """Returns the asset pack of LIBERO's configuration, as in the shim."""
    try:
        from libero.libero import get_assets_path
    except ImportError:
        return None
    path: str = get_assets_path()
    return path
