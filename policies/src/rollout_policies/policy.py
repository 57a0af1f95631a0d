"""The class to subclass."""

from __future__ import annotations

import abc
from typing import Sequence

import numpy as np

from .description import Description
from .episode import Episode, Observation

ACTION_WIDTH = 7


class Policy(abc.ABC):
    """A policy: a description and two methods.

    Calls come one at a time, whatever the number of episodes under way, so a
    model on one device needs no lock. What belongs to one episode goes into
    `episode.memory`, never into `self`: episodes interleave.
    """

    #: What the policy is and wants to see: a class attribute, or set by
    #: `__init__`.
    description: Description

    @abc.abstractmethod
    def reset(self, episode: Episode) -> None:
        """Starts an episode. One that was under way may be started anew."""

    @abc.abstractmethod
    def infer(self, observation: Observation) -> np.ndarray:
        """Answers actions [n, 7], 0 < n <= horizon; [7] is taken as n = 1.

        Each is end-effector translation (3) and rotation (3) and the gripper
        (-1 open, 1 closed), within -1..1. Random numbers come from
        `observation.rng` only. A retry never gets here: the server repeats
        its last answer. An exception fails the rollout's attempt, with its
        message, and is not counted as a failure of the task.
        """

    def infer_batch(self, observations: Sequence[Observation]) -> Sequence[np.ndarray]:
        """Answers several episodes' observations at once, in their order.

        Only called if the description's max_batch is above 1.
        """
        return [self.infer(observation) for observation in observations]


class UnusableActions(ValueError):
    """A policy answered something that is no chunk of actions."""


def read_actions(answer: object, horizon: int) -> np.ndarray:
    """Checks a policy's answer and returns it as float32 [n, 7].

    Raises UnusableActions. Numbers beyond -1..1 pass: the worker clips them,
    and counts them in the result.
    """
    try:
        actions = np.atleast_2d(np.asarray(answer, dtype=np.float32))
    except (TypeError, ValueError) as error:
        raise UnusableActions(f"it answered no array of numbers: {error}") from error
    if actions.ndim != 2 or actions.shape[1] != ACTION_WIDTH:
        raise UnusableActions(f"its actions have shape {list(actions.shape)}, not [n, 7]")
    if not 1 <= len(actions) <= horizon:
        raise UnusableActions(f"it answered {len(actions)} actions, of a horizon of {horizon}")
    if not np.isfinite(actions).all():
        row, column = np.argwhere(~np.isfinite(actions))[0]
        raise UnusableActions(
            f"component {column} of action {row} is {actions[row, column]}"
        )
    return actions
