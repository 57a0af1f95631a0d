"""The environments that scripts construct, with the changes that the path of the BDDL file names:
the view of `agentview`, the arm's posture at resets, and the corruption of `agentview`'s frames."""

from __future__ import annotations

import os
from typing import Any

from numpy.typing import NDArray

import libero.libero.envs.env_wrapper as _libero
from libero.libero.envs import bddl_base_domain
from libero.libero.envs._lazy import Observation
from libero.libero.envs._simulation import draw_numbers
from libero.libero.envs.bddl_base_domain import BDDLBaseDomain
from libero.libero.paths import get_assets_path
from rollout_libero._native import PlusPath, plus_problem_parent
from rollout_libero.plus import check_assets

__all__ = [
    "TASK_MAPPING",
    "ControlEnv",
    "DemoRenderEnv",
    "OffScreenRenderEnv",
    "SegmentationRenderEnv",
]

_CAMERA = "agentview"
_IMAGE = f"{_CAMERA}_image"

#: Classes that simulate the problems, by the problem's name: all of LIBERO's problems, and the
#: problems of LIBERO-Plus for which an environment was constructed.
TASK_MAPPING: dict[str, type[BDDLBaseDomain]] = dict(bddl_base_domain.TASK_MAPPING)


class _VariantEnv(_libero.ControlEnv):
    """LIBERO's environment with the changes of a variant, except the corruption of frames."""

    #: Number of the corruption, 1 to 50; 0 if there is none.
    noise: int
    _change: PlusPath

    def _construct(self, bddl_file_name: str | os.PathLike[str], **arguments: Any) -> None:
        self._change = PlusPath(os.fspath(bddl_file_name))
        self.noise = self._change.noise
        check_assets(bddl_file_name, get_assets_path())
        super()._construct(self._change.file, change=self._change, **arguments)

    @staticmethod
    def _problem_class(name: str) -> type[BDDLBaseDomain] | None:
        parent = plus_problem_parent(name)
        if name not in TASK_MAPPING and parent is not None:
            # The classes differ only in the scene's files, which the simulator chooses by the
            # problem's name.
            TASK_MAPPING[name] = type(name, (TASK_MAPPING[parent],), {"__module__": __name__})
        return TASK_MAPPING.get(name)


class ControlEnv(_VariantEnv):
    """A variant, controlled at 20 Hz. Frames have row 0 at the bottom. Frames of `agentview` that
    `reset` and `step` return are corrupted; the frame that `set_init_state` returns is not.

    The corruption of each frame draws from NumPy's global generator, as resets do. The numbers are
    drawn during `reset` or `step`, in LIBERO-Plus' order, even if the frame is never read."""

    _size: tuple[int, int] | None

    def _construct(self, bddl_file_name: str | os.PathLike[str], **arguments: Any) -> None:
        super()._construct(bddl_file_name, **arguments)
        env = self.env
        sizes = dict(zip(env.camera_names, zip(env.camera_heights, env.camera_widths)))
        self._size = sizes.get(_CAMERA) if self.noise else None
        if self._size is not None:
            self._change.check(*self._size)

    def reset(self) -> Any:
        return self._corrupt(super().reset())

    def step(self, action: Any) -> tuple[Any, float, bool, dict[str, Any]]:
        observation, *rest = super().step(action)
        return self._corrupt(observation), *rest

    def _corrupt(self, observation: Any) -> Any:
        if self._size is None or _IMAGE not in observation:
            return observation
        assert isinstance(observation, Observation)
        change, (height, width) = self._change, self._size
        state = draw_numbers(lambda state: (change.skip(state, height, width), state))

        def corrupted(picture: NDArray[Any]) -> NDArray[Any]:
            return change.corrupted(state, picture)

        if _CAMERA not in self.env.unused_cameras:
            observation.change(_IMAGE, corrupted)
        return observation


class OffScreenRenderEnv(ControlEnv):
    """A variant with frames of its cameras, for evaluation. Takes `ControlEnv`'s arguments by
    name."""

    def __init__(self, bddl_file_name: str | os.PathLike[str], **kwargs: Any) -> None:
        kwargs["has_renderer"] = False
        kwargs["has_offscreen_renderer"] = True
        super().__init__(bddl_file_name=bddl_file_name, **kwargs)


class SegmentationRenderEnv(_VariantEnv, _libero.SegmentationRenderEnv):
    """A variant whose cameras also label each pixel. As in LIBERO-Plus, its frames are not
    corrupted, and no random numbers are drawn for a corruption."""


class DemoRenderEnv(ControlEnv, _libero.DemoRenderEnv):
    """A variant with frames of its cameras, for replaying demonstrations."""
