"""Permitted differences of frames from the original's, as in docs/dev/FIDELITY.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Number of pixels that may differ by more than two of 255 grey levels in any frame, however small.
MAX_DIFFERENT = 8
#: Smallest share of pixels equal to the original's recorded frames.
AS_RECORDED = 0.94
#: Smallest share of pixels equal to frames that the original renders on this machine. The renderer
#: reproduces the roundings of Mesa's llvmpipe on an Intel processor; on others, llvmpipe rounds
#: differently, mostly on the floor of libero_object.
RENDERED_HERE = 0.85


def assert_close_frames(
    ours: NDArray[np.uint8], theirs: NDArray[np.uint8], label: str, at_least: float = AS_RECORDED
) -> None:
    """Checks that enough of the pixels are equal, and 99.97 % within two levels. In any frame,
    `MAX_DIFFERENT` pixels may differ more, because small frames consist largely of edges."""
    assert ours.shape == theirs.shape and ours.dtype == theirs.dtype == np.uint8, label
    differences = np.abs(ours.astype(int) - theirs.astype(int)).max(axis=-1)
    equal, far = (differences == 0).mean(), (differences > 2).sum()
    assert equal >= at_least, f"{label}: {equal:.4%} of the pixels are equal"
    assert far <= max(0.0003 * differences.size, MAX_DIFFERENT), (
        f"{label}: {far} pixels differ by more than two levels"
    )
