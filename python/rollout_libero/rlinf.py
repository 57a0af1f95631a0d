"""RLinf's LIBERO environments in one process: ``export RLINF_EXT_MODULE=rollout_libero.rlinf``.

RLinf imports the module that this variable names in each of its workers and calls ``register``.
RLinf's ``LiberoEnv`` still chooses tasks and initial states, computes rewards and metrics,
truncates and resets; only the simulation is replaced. RLinf itself starts a process for each
environment, which renders and sends every observation. With this module, threads of the worker
simulate, and render only the last observation of each chunk, which is the policy's input.

If a run saves videos or collects data, every step is rendered, which is slow: set
``video_cfg.save_video`` and ``data_collection.enabled`` to ``False`` for training."""

from __future__ import annotations

import os
from typing import Any

from rollout_libero._rlinf_plus import PlusRows
from rollout_libero._rlinf_rows import Rows, as_array

_PARAMETERS = {"bddl_file_name", "camera_heights", "camera_widths", "seed"}


def register() -> None:
    """Replaces RLinf's ``LiberoEnv`` if ``LIBERO_TYPE`` is ``standard`` or ``plus``. A second call
    has no effect."""
    kind = os.environ.get("LIBERO_TYPE", "standard").lower()
    rows = {"standard": Rows, "plus": PlusRows}.get(kind)
    if rows is None:
        print(f"rollout_libero.rlinf: LIBERO_TYPE is {kind}; RLinf's own processes simulate")
        return
    from rlinf.envs.libero import libero_env

    if not getattr(libero_env.LiberoEnv, "simulates_in_process", False):
        libero_env.LiberoEnv = in_process_subclass(libero_env.LiberoEnv, rows)


def in_process_subclass(base: Any, rows: type[Rows]) -> Any:
    """Returns a subclass of RLinf's ``LiberoEnv`` that simulates in one process, with ``rows`` in
    place of RLinf's processes."""

    class LiberoEnv(base):  # type: ignore[misc]
        """RLinf's LIBERO, simulated by ``rollout_libero``."""

        simulates_in_process = True

        def _init_env(self) -> None:
            parameters = self.get_env_fn_params()
            unknown = {name for each in parameters for name in each} - _PARAMETERS
            if unknown:
                raise ValueError(
                    f"env.init_params has {', '.join(sorted(unknown))}, which rollout_libero.rlinf "
                    "does not support: leave it out, or unset RLINF_EXT_MODULE"
                )
            draws_all = _is_recorded(self.cfg)
            if draws_all:
                print(
                    "rollout_libero.rlinf: videos are saved or data is collected, so every step is "
                    "rendered: for speed, set video_cfg.save_video and data_collection.enabled to "
                    "False"
                )
            self.env = rows(parameters, threads=_threads(), draws_all=draws_all)

        def chunk_step(self, chunk_actions: Any) -> Any:
            with self.env.chunk(as_array(chunk_actions)):
                return super().chunk_step(chunk_actions)

        def _wrap_obs(self, obs_list: Any) -> Any:
            # RLinf reads the last observation of a chunk, and skips None.
            return None if obs_list is None else super()._wrap_obs(obs_list)

    LiberoEnv.__qualname__ = LiberoEnv.__name__
    LiberoEnv.__module__ = base.__module__
    return LiberoEnv


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
