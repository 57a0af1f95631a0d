"""The class to subclass."""

from __future__ import annotations

import abc
import inspect
import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .actions import read_actions
from .description import Description
from .episode import Episode, Observation
from .fake import TASKS, fake_episode, fake_observation

log = logging.getLogger("rollout_policies")


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

    def end(self, episode: Episode) -> None:  # noqa: B027 - most policies need nothing here
        """Notes that an episode is over: it ended, was started anew, or was
        forgotten because nothing was heard of it. The server lets go of
        `episode.memory` afterwards, so that most policies need nothing here."""

    def warm_up(self) -> None:
        """Does once, before the server accepts a connection, what makes the
        first answer slow, such as compiling.

        Answers made-up observations unless overridden: one, and a full batch
        if there are batches. What this raises ends the server before it began.
        """
        _answer_made_up(self)


class UnusableDescription(TypeError):
    """A policy does not say what it is, or lacks a method that it is called by."""


#: What the server calls, and the names of the arguments that it passes.
_CALLS = {
    "reset": ("episode",),
    "infer": ("observation",),
    "infer_batch": ("observations",),
    "prepare": ("observation",),
    "end": ("episode",),
    "warm_up": (),
}


def require_methods(policy_class: type[Policy]) -> None:
    """Checks that the server can call every method of a class. Raises
    UnusableDescription, which names the method and the line to write."""
    name = policy_class.__name__
    for method, arguments in _CALLS.items():
        line = f"`def {method}({', '.join(('self', *arguments))})`"
        function = getattr(policy_class, method, None)
        if method in getattr(policy_class, "__abstractmethods__", ()):
            raise UnusableDescription(f"policy {name} has no method {method!r}: write {line}")
        if not callable(function):
            raise UnusableDescription(f"{method!r} of policy {name} is no method: write {line}")
        if inspect.iscoroutinefunction(function):
            raise UnusableDescription(
                f"method {method!r} of policy {name} is a coroutine, and the server calls plain"
                f" functions: write {line}"
            )
        kind = inspect.getattr_static(policy_class, method)
        implied = () if isinstance(kind, (staticmethod, classmethod)) else (policy_class,)
        try:
            signature = inspect.signature(function)
        except ValueError:  # A method written in C may not tell.
            continue
        try:
            signature.bind(*implied, *arguments)
        except TypeError:
            raise UnusableDescription(
                f"method {method!r} of policy {name} takes {signature}, and the server calls"
                f" {method}({', '.join(arguments)}): write {line}"
            ) from None


def description_of(policy: Policy) -> Description:
    """Returns a policy's description. Raises UnusableDescription, also for a policy
    whose methods cannot be called."""
    name = type(policy).__name__
    if not isinstance(policy, Policy):
        remedy = " (make one: MyPolicy(), not MyPolicy)" if isinstance(policy, type) else ""
        raise UnusableDescription(
            f"{policy!r} is no policy: give an instance of a subclass of"
            f" rollout_policies.Policy{remedy}"
        )
    require_methods(type(policy))
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


def _answer_made_up(policy: Policy) -> None:
    """Has a policy answer a made-up observation and, if it takes batches, a full
    batch of them, in episodes that are ended again.

    A policy that accepts no episode of any suite is left cold, with a warning: it
    may know other tasks than those made up here. Raises what its methods raise, and
    UnusableActions.
    """
    description = policy.description
    sizes = sorted({1, description.max_batch})
    episodes: list[Episode] = []
    try:
        for at in range(sizes[-1]):
            episode = _begun(policy, at)
            if episode is None:
                return
            episodes.append(episode)
        for size in sizes:
            # Of each episode its next query: the first one has been alone before.
            asked = [
                fake_observation(description, at, int(size > 1 and at == 0), episode)
                for at, episode in enumerate(episodes[:size])
            ]
            asked = [replace(one, prepared=policy.prepare(one)) for one in asked]
            answers = [policy.infer(asked[0])] if size == 1 else policy.infer_batch(asked)
            for answer in answers:
                read_actions(answer, description.horizon)
    finally:
        for episode in episodes:
            policy.end(episode)


def _begun(policy: Policy, seed: int) -> Episode | None:
    """Begins an episode of the first suite whose task the policy accepts."""
    refusals = []
    for suite in TASKS:
        episode = fake_episode(suite, seed, f"warm-up {seed}")
        try:
            policy.reset(episode)
            return episode
        except Exception as error:
            refusals.append(f"{suite}: {error}")
    log.warning(
        "policy %r is not warmed up, because it refuses a made-up episode of every suite (%s);"
        " its first answer may be slow",
        policy.description.name,
        "; ".join(refusals),
    )
    return None
