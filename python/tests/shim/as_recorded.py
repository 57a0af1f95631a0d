"""Configures the original as it was configured when the reference was recorded.

Scripts that run with the original and with the shim import this module. With the shim, the module
changes nothing."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np


def _disable_native_ccd() -> None:
    """Disables `nativeccd`, so that MuJoCo 3.3.7 detects collisions as the benchmark's MuJoCo
    2.3.7 does."""
    import mujoco
    from robosuite.utils import binding_utils

    construct = binding_utils.MjSim.__init__

    def init(self: Any, model: Any) -> None:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
        construct(self, model)

    binding_utils.MjSim.__init__ = init


def _widen_segment_ids() -> None:
    """Widens the segment ids that robosuite 1.4.0 computes in bytes, which overflow in NumPy 2."""
    import mujoco
    from robosuite.utils import binding_utils

    read = binding_utils.MjRenderContext.read_pixels

    def read_pixels(
        self: Any, width: int, height: int, depth: bool = False, segmentation: bool = False
    ) -> Any:
        if not segmentation:
            return read(self, width, height, depth=depth)
        colours = np.empty((height, width, 3), dtype=np.uint8)
        viewport = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_readPixels(rgb=colours, depth=None, viewport=viewport, con=self.con)
        segments = colours.astype(np.int64) @ [1, 1 << 8, 1 << 16]
        ids = np.full((self.scn.ngeom + 1, 2), -1, dtype=np.int32)
        for geom in self.scn.geoms[: self.scn.ngeom]:
            if geom.segid != -1:
                ids[geom.segid + 1] = geom.objtype, geom.objid
        return ids[np.where(segments <= self.scn.ngeom, segments, 0)]

    binding_utils.MjRenderContext.read_pixels = read_pixels


if importlib.util.find_spec("robosuite") is not None:
    _disable_native_ccd()
    _widen_segment_ids()
