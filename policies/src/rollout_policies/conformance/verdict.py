"""The verdicts: pure functions of a server's answers."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass

import grpc
import numpy as np

from ..actions import ACTION_WIDTH, UnusableActions, read_actions
from ..description import Description
from ..proto import policy_pb2 as pb

#: Largest plausible magnitude of a component of an action before the worker clips it to 1. A policy
#: that exceeds it answers in other units.
LARGEST_PLAUSIBLE = 2.0
#: Largest difference that batching may cause in an action. Kernels for different batch sizes add
#: in different orders, which changes low-order bits.
BATCH_TOLERANCE = 1e-3


class Word(enum.Enum):
    """Result of a server on one point."""

    PASS = "pass"
    FAIL = "FAIL"
    #: The point does not apply.
    SKIP = "skip"


@dataclass(frozen=True)
class Verdict:
    """Result of a server on one point, with an explanation."""

    word: Word
    text: str = ""

    @property
    def failed(self) -> bool:
        """True if the protocol is violated."""
        return self.word is Word.FAIL


def passed(note: str = "") -> Verdict:
    return Verdict(Word.PASS, note)


def failed(reason: str) -> Verdict:
    return Verdict(Word.FAIL, reason)


def skipped(reason: str) -> Verdict:
    return Verdict(Word.SKIP, reason)


def refused(error: grpc.RpcError) -> Verdict:
    """Returns the failure for a call that the server answered with an error."""
    return failed(f"the server refused: {describe_error(error)}")


def describe_error(error: grpc.RpcError) -> str:
    """Describes a failed call."""
    return f"{error.details()} ({error.code().name})"


def description(described: pb.DescribeResponse) -> Verdict:
    """Checks that a description is consistent."""
    try:
        Description.from_message(described)
    except ValueError as error:
        return failed(str(error))
    return passed(
        f'"{described.name}", checkpoint "{described.checkpoint}", horizon {described.horizon},'
        f" execute {described.execute}"
    )


def shapes(answers: Sequence[pb.InferResponse], horizon: int) -> Verdict:
    """Checks that every answer of an episode holds a valid chunk of actions. Answers are in the
    order of their query indexes."""
    for at, answer in enumerate(answers):
        numbers = len(answer.actions)
        if answer.action_width != ACTION_WIDTH:
            return failed(
                f"at query {at}, its actions are {answer.action_width} numbers wide, not"
                f" {ACTION_WIDTH}"
            )
        if numbers % ACTION_WIDTH:
            return failed(
                f"at query {at}, it answered {numbers} numbers, which is not a multiple of"
                f" {ACTION_WIDTH}"
            )
        try:
            read_actions(np.reshape(answer.actions, (-1, ACTION_WIDTH)), horizon)
        except UnusableActions as error:
            return failed(f"at query {at}, {error}")
    return passed()


def numbers_range(answers: Sequence[pb.InferResponse]) -> Verdict:
    """Checks that no number is beyond the plausible range of actions."""
    largest = max((abs(number) for answer in answers for number in answer.actions), default=0.0)
    if largest <= 1.0:
        return passed()
    if largest <= LARGEST_PLAUSIBLE:
        return passed(f"the largest is {largest:.4g}: workers clip such numbers and count them")
    return failed(f"the largest is {largest:.4g}: check how the policy un-normalises actions")


def same(expected: Sequence[pb.InferResponse], answers: Sequence[pb.InferResponse]) -> Verdict:
    """Checks that two episodes got the same answers, bit for bit."""
    query = first_difference(expected, answers)
    return passed() if query is None else failed(f"at query {query} the actions differ")


def seeds(
    stochastic: bool, first: Sequence[pb.InferResponse], second: Sequence[pb.InferResponse]
) -> Verdict:
    """Checks that two episodes of different seeds have different answers exactly if the policy is
    declared stochastic."""
    at = first_difference(first, second)
    if stochastic and at is None:
        return failed("it declares itself stochastic, but seeds 1 and 2 give the same actions")
    if not stochastic and at is not None:
        return failed(f"it declares itself deterministic, but seeds 1 and 2 differ at query {at}")
    return passed()


def batch(alone: Sequence[pb.InferResponse], batched: Sequence[pb.InferResponse]) -> Verdict:
    """Checks that answers in a batch equal those to single queries, up to BATCH_TOLERANCE."""
    if first_difference(alone, batched) is None:
        return passed("bit for bit")
    lengths = [[len(answer.actions) for answer in answers] for answers in (alone, batched)]
    if lengths[0] != lengths[1]:
        return failed("in a batch the answers have other numbers of actions")
    differences = [abs(a - b) for a, b in zip(_numbers(alone), _numbers(batched))]
    # `max` may miss a NaN, because comparisons with it are false.
    largest = math.nan if any(map(math.isnan, differences)) else max(differences)
    if largest <= BATCH_TOLERANCE:
        return passed(
            f"except by up to {largest:.1e}: actions depend on the batch in low-order bits"
        )
    return failed(f"in a batch the actions differ by up to {largest:.4g}")


def speed(
    alone: Sequence[float], concurrency: int, wall_secs: float, concurrent: Sequence[float]
) -> Verdict:
    """Reports the latencies, s, of single queries and of `concurrency`
    concurrent episodes that took `wall_secs` in total."""
    return passed(
        f"one by one {_percentiles(alone)}; {concurrency} episodes at once"
        f" {_percentiles(concurrent)}, {len(concurrent) / wall_secs:.0f} queries/s"
    )


def first_difference(
    first: Sequence[pb.InferResponse], second: Sequence[pb.InferResponse]
) -> int | None:
    """Returns the first query at which two episodes differ, or None."""
    bits = [
        [np.array(answer.actions, dtype=np.float32).tobytes() for answer in answers]
        for answers in (first, second)
    ]
    for at, (a, b) in enumerate(zip(*bits)):
        if a != b:
            return at
    return None if len(first) == len(second) else min(len(first), len(second))


def _numbers(answers: Sequence[pb.InferResponse]) -> list[float]:
    return [number for answer in answers for number in answer.actions]


def _percentiles(latencies: Sequence[float]) -> str:
    ordered = sorted(latencies)

    def at(share: float) -> float:
        return 1e3 * ordered[max(1, math.ceil(share * len(ordered))) - 1]

    return f"p50 {at(0.5):.2f} ms, p99 {at(0.99):.2f} ms"
