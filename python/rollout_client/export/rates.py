"""Success rates of a campaign as they came about, for tools that show curves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ..archive import Archive


@dataclass(frozen=True)
class Point:
    """What was known after a result."""

    #: `L2/camera`, and `L0/clean` of nominal rollouts.
    condition: str
    #: Results of the condition so far, and successes among them.
    results: int
    successes: int
    #: When the last of them was committed, seconds since the Unix epoch.
    committed: float

    @property
    def rate(self) -> float:
        """A fraction."""
        return self.successes / self.results


def points(archive: Archive) -> Iterator[Point]:
    """A point after each result, in the order in which they were committed."""
    so_far: dict[str, tuple[int, int]] = {}
    rollouts = [
        (it.committed_ms, it.rollout_id, it.replicate, f"{it.level}/{it.axis}", it.success)
        for it in archive.rollouts()
    ]
    for committed_ms, _, _, condition, success in sorted(rollouts):
        results, successes = so_far.get(condition, (0, 0))
        so_far[condition] = (results + 1, successes + success)
        yield Point(condition, results + 1, successes + success, committed_ms / 1_000)
