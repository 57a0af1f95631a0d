"""Conversion between a network's range, -1..1, and the units of its training data, and averaging of
overlapping chunks."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np


def within_bounds(
    values: np.ndarray, low: Sequence[float], high: Sequence[float], mask: Sequence[bool]
) -> np.ndarray:
    """Scales values in the training data's units to -1..1, `low` to -1 and `high` to 1, and
    clips; values outside `mask` are only clipped. Equals OpenVLA-OFT's `normalize_proprio`."""
    least, most = np.asarray(low), np.asarray(high)
    scaled = 2 * (values - least) / (most - least + 1e-8) - 1
    return np.clip(np.where(mask, scaled, values), -1.0, 1.0)


def from_bounds(
    values: np.ndarray, low: Sequence[float], high: Sequence[float], mask: Sequence[bool]
) -> np.ndarray:
    """Scales -1..1 back to the training data's units where `mask` is set. Equals UniVLA's decoder
    if `low` and `high` are the 1st and the 99th percentile."""
    least, most = np.asarray(low), np.asarray(high)
    return np.where(mask, 0.5 * (values + 1) * (most - least) + least, values)


@dataclass
class Ensemble:
    """Weighted mean of the last chunks' actions for the current step.

    The newest chunk has weight 1, and a chunk that is `age` queries older has weight exp(-decay *
    age). Equals UniVLA's `ActionDecoder` if the decay is 0.1."""

    decay: float
    #: Chunks [n, 7] of successive queries, the newest first.
    chunks: deque[np.ndarray] = field(default_factory=deque)

    def add(self, chunk: np.ndarray) -> np.ndarray:
        """Adds the chunk of this query and returns the current action [7]."""
        self.chunks.appendleft(np.asarray(chunk, dtype=np.float64))
        # A chunk of n actions ends before the n-th query after it.
        while len(self.chunks) > len(self.chunks[-1]):
            self.chunks.pop()
        weights = np.exp(-self.decay * np.arange(len(self.chunks)))
        actions = np.stack([chunk[age] for age, chunk in enumerate(self.chunks)])
        return weights @ actions / weights.sum()
