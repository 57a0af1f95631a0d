"""Drivers of an episode: the expert, the disturbed expert, or student and expert in turns.

Each class serves n environments at once, and draws from a random generator."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from training.network import ARM, CHUNK
from training.shards import Driver

ACTION_SIZE = ARM + 1
"""Numbers of an action."""

CLEAN_SHARE = 0.2
"""Share of the expert's episodes without disturbances."""
NOISE = (0.05, 0.4)
"""Least and greatest standard deviation of the noise on the six numbers of the arm."""
QUIET_SHARE = 0.25
"""Share of a disturbed episode's intervals that are without noise."""
NOISE_STEPS = (10, 60)
"""Least and most steps of an interval, in which the standard deviation of the noise is constant."""
PUSH_CHANCE = 1 / 120
"""Probability that a push begins in a step of a disturbed episode."""
PUSH_STEPS = (3, 10)
"""Least and most steps of a push."""
PUSH_SIZE = (0.5, 1.5)
"""Least and largest translation of a push. A push is added to the expert's action, which is in
-1..1; a push of 2 or more would outweigh any action of the expert."""
PUSH_ROTATION = 0.4
"""Size of a push's rotation relative to the push's translation."""

ALONE_SHARE = 0.2
"""Share of the episodes that the student drives from beginning to end."""
DISTURBED_SHARE = 0.5
"""Share of the episodes driven in turns in which the expert's turns are disturbed."""
STUDENT_STEPS = (16, 160)
EXPERT_STEPS = (12, 60)
"""Least and most steps of a turn of the student, and of the expert."""
HORIZONS = (CHUNK, CHUNK, CHUNK // 2)
"""Numbers of actions of an answer that the student executes before the next query. Each turn has
one of these numbers, drawn at random."""


class Commands(NamedTuple):
    """Actions of n environments in their next k steps."""

    actions: NDArray[np.float64]
    """[n, k, 7]: added to the expert's actions where the expert drives, executed unchanged
    elsewhere."""
    expert: NDArray[np.bool_]
    """[n, k]: True where the expert drives."""


class Disturbance:
    """Intervals of noise, and pushes, in some of n environments."""

    def __init__(self, n: int, rng: np.random.Generator) -> None:
        self._rng = rng
        self._disturbed = np.zeros(n, bool)
        self._sigma = np.zeros(n)
        self._noise_left = np.zeros(n, np.int64)
        self._push = np.zeros((n, ARM))
        self._push_left = np.zeros(n, np.int64)

    def begin(self, indices: NDArray[np.int64], disturbed: NDArray[np.bool_]) -> None:
        self._disturbed[indices] = disturbed
        self._noise_left[indices] = 0
        self._push_left[indices] = 0

    def next(self, steps: int) -> NDArray[np.float64]:
        """Returns the numbers to be added to the next actions, [n, steps, 7]; the gripper is the
        expert's."""
        added = np.stack([self._step() for _ in range(steps)], axis=1)
        return np.concatenate([added, np.zeros_like(added[..., :1])], axis=-1)

    def _step(self) -> NDArray[np.float64]:
        rng, n = self._rng, len(self._disturbed)
        begins = self._disturbed & (self._noise_left == 0)
        sigma = rng.uniform(*NOISE, n) * (rng.random(n) >= QUIET_SHARE)
        self._sigma = np.where(begins, sigma, self._sigma)
        self._noise_left = np.where(begins, _draw_steps(rng, NOISE_STEPS, n), self._noise_left)
        self._noise_left = np.maximum(self._noise_left - 1, 0)

        starts = self._disturbed & (self._push_left == 0) & (rng.random(n) < PUSH_CHANCE)
        self._push[starts] = self._draw_pushes(int(starts.sum()))
        self._push_left = np.where(starts, _draw_steps(rng, PUSH_STEPS, n), self._push_left)
        pushed = self._push_left > 0
        self._push_left = np.maximum(self._push_left - 1, 0)

        sigma = np.where(self._disturbed, self._sigma, 0.0)
        added = rng.normal(size=(n, ARM)) * sigma[:, np.newaxis]
        return np.where(pushed[:, np.newaxis], self._push, added)

    def _draw_pushes(self, count: int) -> NDArray[np.float64]:
        """Draws pushes in random directions and of random size, [count, 6]."""
        push = self._rng.normal(size=(count, ARM))
        push /= np.abs(push[:, :3]).max(axis=1, keepdims=True)
        push[:, 3:] = np.clip(PUSH_ROTATION * push[:, 3:], -1.0, 1.0)
        return push * self._rng.uniform(*PUSH_SIZE, (count, 1))


class ExpertDriver:
    """The expert as driver of n environments, disturbed in most episodes."""

    def __init__(self, n: int, rng: np.random.Generator) -> None:
        self._rng = rng
        self._disturbance = Disturbance(n, rng)
        self.driver = np.full(n, Driver.CLEAN, np.uint8)

    def begin(self, indices: NDArray[np.int64]) -> None:
        disturbed = self._rng.random(len(indices)) >= CLEAN_SHARE
        self._disturbance.begin(indices, disturbed)
        self.driver[indices] = np.where(disturbed, Driver.DISTURBED, Driver.CLEAN)

    def next(self, steps: int) -> Commands:
        added = self._disturbance.next(steps)
        return Commands(added, np.ones(added.shape[:2], bool))


class AlternatingDrivers:
    """Student and expert as drivers of n environments, in turns. In some episodes, the student
    drives alone.

    The driver changes only between calls of ``next``."""

    def __init__(self, n: int, rng: np.random.Generator) -> None:
        self._rng = rng
        self._disturbance = Disturbance(n, rng)
        self._student = np.zeros(n, bool)
        self._turn_left = np.zeros(n, np.int64)
        self._horizon = np.full(n, CHUNK)
        self._answers = np.zeros((n, CHUNK, ACTION_SIZE))
        self._used = np.full(n, CHUNK)
        self.driver = np.full(n, Driver.IN_TURNS, np.uint8)

    def begin(self, indices: NDArray[np.int64]) -> None:
        rng, count = self._rng, len(indices)
        alone = rng.random(count) < ALONE_SHARE
        self._disturbance.begin(indices, rng.random(count) < DISTURBED_SHARE)
        self.driver[indices] = np.where(alone, Driver.STUDENT, Driver.IN_TURNS)
        # With no steps left, the next call of `needs_answer` gives the turn to the other driver.
        self._student[indices] = rng.random(count) < 0.5
        self._turn_left[indices] = 0

    def needs_answer(self) -> NDArray[np.bool_]:
        """Returns a mask [n] of the environments that need an answer of the student for their next
        steps.

        Call ``needs_answer`` once before each call of ``next``."""
        rng, n = self._rng, len(self._student)
        turn_begins = self._turn_left <= 0
        alone = self.driver == Driver.STUDENT
        self._student = np.where(turn_begins, ~self._student | alone, self._student)
        turns = np.where(
            self._student, _draw_steps(rng, STUDENT_STEPS, n), _draw_steps(rng, EXPERT_STEPS, n)
        )
        self._turn_left = np.where(turn_begins, turns, self._turn_left)
        self._horizon = np.where(turn_begins, rng.choice(HORIZONS, n), self._horizon)
        return self._student & (turn_begins | (self._used >= self._horizon))

    def answer(self, mask: NDArray[np.bool_], answers: NDArray[np.float64]) -> None:
        """Stores the student's answers, [m, 8, 7], for the m environments of ``mask``."""
        self._answers[mask] = answers
        self._used[mask] = 0

    def next(self, steps: int) -> Commands:
        """Returns the commands of the next ``steps`` steps; ``steps`` must divide the horizons."""
        added = self._disturbance.next(steps)
        positions = np.minimum(self._used[:, np.newaxis] + np.arange(steps), CHUNK - 1)
        answers = np.take_along_axis(self._answers, positions[:, :, np.newaxis], axis=1)
        student = self._student[:, np.newaxis]
        actions = np.where(student[:, :, np.newaxis], answers, added)
        self._used += steps
        self._turn_left -= steps
        return Commands(actions, np.broadcast_to(~student, actions.shape[:2]))


def _draw_steps(rng: np.random.Generator, limits: tuple[int, int], n: int) -> NDArray[np.int64]:
    return rng.integers(limits[0], limits[1] + 1, n)
