"""Statistics that convert between a network's normalised numbers and the units of its training
data, which are those of LIBERO's states and actions.

A checkpoint without them loads and moves, but its actions stay normalised as in training, and every
task fails."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from .upstream import UnusableCheckpoint

#: Statistics that each normalisation mode needs, with lerobot's names.
NEEDED = {
    "MEAN_STD": ("mean", "std"),
    "MIN_MAX": ("min", "max"),
    "QUANTILES": ("q01", "q99"),
    "QUANTILE10": ("q10", "q90"),
}
ACTION_WIDTH, STATE_WIDTH = 7, 8
#: Number of characters of a digest that are shown.
DIGITS = 12


def require_statistics(
    title: str, mode: str, statistics: Mapping[str, Any], width: int | None = None
) -> str:
    """Checks that a feature's statistics for this normalisation mode exist, are finite, have a
    spread in at least one number, and have `width` numbers unless `width` is None. Returns a short
    text: the feature's `title`, such as "actions", the mode and a digest.

    Raises UnusableCheckpoint."""
    if mode == "IDENTITY":
        return f"{title} not normalised"
    if mode not in NEEDED:
        raise UnusableCheckpoint(f"the checkpoint normalises {title} by {mode}, an unknown mode")
    lacking = [name for name in NEEDED[mode] if name not in statistics]
    if lacking:
        raise UnusableCheckpoint(
            f"the checkpoint has no statistics of {title}: it normalises them by {mode} and lacks"
            f" {' and '.join(lacking)}. Without them the arm moves but every task fails, as with a"
            " base model that was not fine-tuned; serve a checkpoint that was trained on LIBERO,"
            " with the processors that were saved beside it"
        )
    low, high = (np.asarray(statistics[name], dtype=np.float64) for name in NEEDED[mode])
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise UnusableCheckpoint(f"the checkpoint's statistics of {title} are not finite")
    spread = high if mode == "MEAN_STD" else high - low
    if not (spread != 0).any():
        raise UnusableCheckpoint(
            f"the checkpoint's statistics of {title} have no spread: they were never computed"
        )
    if width is not None and {low.size, high.size} != {width}:
        raise UnusableCheckpoint(
            f"the checkpoint's statistics of {title} are {low.size} numbers, and LIBERO's are"
            f" {width}: it was trained for another robot"
        )
    return f"{title} {mode} {digest(statistics)}"


def digest(statistics: Mapping[str, Any]) -> str:
    """Returns the first digits of SHA-256 over the named numbers."""
    total = hashlib.sha256()
    for name in sorted(statistics):
        total.update(name.encode())
        total.update(np.asarray(statistics[name], dtype="<f8").tobytes())
    return total.hexdigest()[:DIGITS]
