"""The class to subclass."""

from __future__ import annotations

import abc
from typing import Any, Sequence

import numpy as np

from .description import Description
from .episode import Episode, Observation
from .warming import answer_made_up


class Policy(abc.ABC):
    """A policy: a description and two methods.

    Calls come one at a time and from one thread, whatever the number of
    episodes under way, so a model on one device needs no lock and may be
    compiled; `prepare` alone is called from others. With `serve` and `run` it
    is the thread that calls them, so that the constructor runs there, too.
    What belongs to one episode goes into `episode.memory`, never into `self`:
    episodes interleave.
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

        Each is end-effector translation (3) and rotation (3), within -1..1,
        and the gripper, as the description's `gripper` says. Random numbers
        come from `observation.rng` only. A retry never gets here: the server
        repeats its last answer. An exception fails the rollout's attempt, with
        its message, and is not counted as a failure of the task.
        """

    def infer_batch(self, observations: Sequence[Observation]) -> Sequence[np.ndarray]:
        """Answers several episodes' observations at once, in their order.

        Only called if the description's max_batch is above 1. If it raises,
        `infer` is asked one by one, so that only the guilty query fails; not if
        the policy is stateful, whose memories may have moved on already, nor
        after an error from which the process does not recover.
        """
        return [self.infer(observation) for observation in observations]

    def prepare(self, observation: Observation) -> Any:
        """Work on an observation that needs neither the model nor
        `episode.memory`, such as decoding or resizing frames.

        Called before `infer`, which finds the result in
        `observation.prepared`. Calls come from several threads and at once,
        while the model answers other queries.
        """
        return None

    def end(self, episode: Episode) -> None:
        """Notes that an episode is over: it ended, was started anew, or was
        forgotten because nothing was heard of it. The server lets go of
        `episode.memory` afterwards, so that most policies need nothing here."""

    def warm_up(self) -> None:
        """Does once, before the server accepts a connection, what makes the
        first answer slow, such as compiling.

        Answers made-up observations unless overridden: one, and a full batch
        if there are batches. What this raises ends the server before it began.
        """
        answer_made_up(self)


class UnusableDescription(TypeError):
    """A policy does not say what it is."""


def description_of(policy: Policy) -> Description:
    """A policy's description. Raises UnusableDescription."""
    name = type(policy).__name__
    if not isinstance(policy, Policy):
        remedy = " (make one: MyPolicy(), not MyPolicy)" if isinstance(policy, type) else ""
        raise UnusableDescription(
            f"{policy!r} is no policy: give an instance of a subclass of"
            f" rollout_policies.Policy{remedy}"
        )
    try:
        described = policy.description
    except AttributeError as error:
        raise UnusableDescription(
            f"policy {name} has no description: write `description = Description(name=...)` in"
            f" the class, or set self.description in __init__ ({error})"
        ) from error
    if not isinstance(described, Description):
        raise UnusableDescription(
            f"the description of policy {name} is of type {type(described).__name__}, not"
            " rollout_policies.Description"
        )
    return described
