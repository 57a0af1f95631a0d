"""The points of the protocol, and the order in which they are checked."""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass

import grpc

from . import verdict
from .probe import QUERIES, CannotCheck, EpisodeAnswers, Probe
from .verdict import Verdict

#: Seed of the reference episode, and another seed.
SEED, OTHER_SEED = 1, 2
#: Concurrent episodes while throughput is measured.
CONCURRENCY = 8


class Point(enum.Enum):
    """A point of the protocol, as a sentence that is true of a conforming server. The members
    are in the order of the checks."""

    DESCRIPTION = "the description is consistent"
    VERSION = "another protocol version is refused"
    HEALTH = "the health service reports SERVING"
    SHAPE = "answers are finite actions, n × 7, within the horizon"
    RANGE = "actions lie within -1..1"
    RETRY = "a retry gets the same actions"
    SAME_SEED = "the same seed gives the same actions"
    OTHER_SEED = "another seed gives other actions exactly if declared stochastic"
    ORDER = "the order of queries does not change the actions"
    ISOLATION = "sessions do not affect one another"
    RESTART = "a Reset starts an open session anew"
    BATCH = "other queries of a batch do not change the actions"
    UNOPENED = "a session that was never opened is refused"
    END = "the end of an episode is accepted"
    SPEED = "answer times are measured"


#: Points that compare episodes of given seeds. They are skipped if the policy's random numbers do
#: not depend on the seed.
SEEDED = frozenset(
    {
        Point.SAME_SEED,
        Point.OTHER_SEED,
        Point.ORDER,
        Point.ISOLATION,
        Point.RESTART,
        Point.BATCH,
    }
)


@dataclass(frozen=True)
class Finding:
    """Verdict about a server on one point."""

    point: Point
    verdict: Verdict

    def __str__(self) -> str:
        text = f": {self.verdict.text}" if self.verdict.text else ""
        return f"{self.verdict.word.value}  {self.point.value}{text}"


def examine(probe: Probe) -> Iterator[Finding]:
    """Checks point by point, by comparison with a reference episode of SEED.

    Raises CannotCheck if the reference episode cannot be played.
    """
    try:
        reference = probe.episode("reference", SEED)
    except grpc.RpcError as error:
        reason = verdict.describe_error(error)
        raise CannotCheck(f"failed to play one episode: {reason}") from error
    for point in Point:
        try:
            result = _check_point(point, probe, reference)
        except grpc.RpcError as error:
            result = verdict.refused(error)
        except CannotCheck as error:
            result = verdict.failed(str(error))
        yield Finding(point, result)


def _check_point(point: Point, probe: Probe, reference: EpisodeAnswers) -> Verdict:
    described, answers = probe.described, reference.answers
    if point in SEEDED and described.unseeded:
        return verdict.skipped(
            "the policy's random numbers do not depend on the seed, so episodes cannot be compared"
        )
    if point is Point.DESCRIPTION:
        return verdict.description(described)
    if point is Point.VERSION:
        return probe.other_version()
    if point is Point.HEALTH:
        return probe.health()
    if point is Point.SHAPE:
        return verdict.shapes(answers, described.horizon)
    if point is Point.RANGE:
        return verdict.numbers_range(answers)
    if point is Point.RETRY:
        return verdict.same(*probe.retries(SEED))
    if point is Point.SAME_SEED:
        return verdict.same(answers, probe.episode("again", SEED).answers)
    if point is Point.OTHER_SEED:
        other_answers = probe.episode("other seed", OTHER_SEED).answers
        return verdict.seeds(described.stochastic, answers, other_answers)
    if point is Point.ORDER:
        if described.stateful:
            return verdict.skipped("the policy is stateful: it requires queries in order")
        backward = probe.episode("backward", SEED, range(QUERIES - 1, -1, -1))
        return verdict.same(answers, backward.answers)
    if point is Point.ISOLATION:
        return verdict.same(answers, probe.interleaved(SEED, OTHER_SEED))
    if point is Point.RESTART:
        return verdict.same(answers, probe.restarted(SEED, OTHER_SEED))
    if point is Point.BATCH:
        if described.max_batch <= 1:
            return verdict.skipped("the policy declares no batches")
        return verdict.batch(answers, probe.batched(SEED))
    if point is Point.UNOPENED:
        return probe.unopened()
    if point is Point.END:
        return probe.ended(SEED)
    wall_secs, concurrent = probe.concurrent_episodes(CONCURRENCY)
    return verdict.speed(reference.latencies, CONCURRENCY, wall_secs, concurrent)
