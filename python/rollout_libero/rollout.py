"""The progress of one environment's rollout."""

from __future__ import annotations

from dataclasses import dataclass

from rollout_libero._library import native
from rollout_libero.configuration import Start

UNTOUCHED = (native.BusyError, native.ClosedError)
"""Errors that are raised before anything has changed."""
REFUSED = (*UNTOUCHED, ValueError)
"""Errors of a call, as opposed to those of the simulation."""


@dataclass
class Rollout:
    """The progress of one environment's rollout.

    A rollout changes only after the simulator has returned, so a refused call leaves it unchanged.
    """

    instruction: str
    max_steps: int
    steps: int = 0
    init_state: int | None = None
    is_begun: bool = False
    is_over: bool = False
    schedule: native.Schedule | None = None
    """Schedule of the policy's queries, replaced at each call and never mutated; None if chunks
    are executed as they are given."""

    def begin(self, start: Start) -> None:
        """Records that the simulator has begun a rollout from this start."""
        self.instruction, self.max_steps = start.instruction, start.max_steps
        self.steps, self.init_state = 0, start.init_state
        self.is_begun, self.is_over = True, False

    def advance(self, steps: int, success: bool, error: Exception | None) -> bool:
        """Counts the executed steps of a call, and ends the rollout if it succeeded, failed or
        spent its budget of steps. Returns True if the budget is spent without success.

        A failed simulation ends the rollout. A call that was refused, or that found the environment
        busy or closed, does not."""
        self.steps += steps
        truncated = error is None and not success and self.steps >= self.max_steps
        failed = error is not None and not isinstance(error, REFUSED)
        # Another thread may have ended the rollout after this thread found the environment busy.
        self.is_over = self.is_over or success or truncated or failed
        return truncated
