"""Permitted differences of frames from the original's, as in docs/FIDELITY.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FEW = 8
AS_RECORDED = 0.94
#: Another processor's driver rounds differently, mostly on the floor of libero_object.
DRAWN_HERE = 0.85


def assert_close_frames(
    ours: NDArray[np.uint8], theirs: NDArray[np.uint8], what: str, at_least: float = AS_RECORDED
) -> None:
    """Checks that enough of the pixels are equal, and 99.97 % within two levels. A few pixels may
    always differ more, because small frames consist largely of edges."""
    assert ours.shape == theirs.shape and ours.dtype == theirs.dtype == np.uint8, what
    off = np.abs(ours.astype(int) - theirs.astype(int)).max(axis=-1)
    equal, far = (off == 0).mean(), (off > 2).sum()
    assert equal >= at_least, f"{what}: {equal:.4%} of the pixels are equal"
    assert far <= max(0.0003 * off.size, FEW), (
        f"{what}: {far} pixels are off by more than two levels"
    )
