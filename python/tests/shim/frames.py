"""Permitted differences of frames from the original's, as in docs/FIDELITY.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Number of pixels of a frame that may always differ by more than two levels.
MAX_DIFFERENT = 8
#: Smallest share of equal pixels, against the original's recorded frames.
AS_RECORDED = 0.94
#: Smallest share of equal pixels, against an original that renders on this machine: another
#: processor's driver rounds differently, mostly on the floor of libero_object.
RENDERED_HERE = 0.85


def assert_close_frames(
    ours: NDArray[np.uint8], theirs: NDArray[np.uint8], what: str, at_least: float = AS_RECORDED
) -> None:
    """Checks that enough of the pixels are equal, and 99.97 % within two levels. A few pixels may
    always differ more, because small frames consist largely of edges."""
    assert ours.shape == theirs.shape and ours.dtype == theirs.dtype == np.uint8, what
    differences = np.abs(ours.astype(int) - theirs.astype(int)).max(axis=-1)
    equal, far = (differences == 0).mean(), (differences > 2).sum()
    assert equal >= at_least, f"{what}: {equal:.4%} of the pixels are equal"
    assert far <= max(0.0003 * differences.size, MAX_DIFFERENT), (
        f"{what}: {far} pixels differ by more than two levels"
    )
