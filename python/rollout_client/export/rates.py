"""Success rates of a campaign over time, for tools that show curves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ..archive import Archive


@dataclass(frozen=True)
class Point:
    """Success rate of a condition after a result."""

    #: Level and axis such as `L2/camera`; `L0/clean` for nominal rollouts.
    condition: str
    #: Number of results of the condition so far, and of successes among them.
    results: int
    successes: int
    #: Commit time of the latest of these results, seconds since the Unix epoch.
    committed: float

    @property
    def rate(self) -> float:
        """Success rate as a fraction."""
        return self.successes / self.results


def points(archive: Archive) -> Iterator[Point]:
    """Yields a point after each result, in the order of the commits."""
    counts: dict[str, tuple[int, int]] = {}
    rollouts = [
        (
            rollout.committed_ms,
            rollout.rollout_id,
            rollout.replicate,
            f"{rollout.level}/{rollout.axis}",
            rollout.success,
        )
        for rollout in archive.rollouts()
    ]
    for committed_ms, _, _, condition, success in sorted(rollouts):
        results, successes = counts.get(condition, (0, 0))
        counts[condition] = (results + 1, successes + success)
        yield Point(condition, results + 1, successes + success, committed_ms / 1_000)
