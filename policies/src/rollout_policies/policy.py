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

    Calls are made one at a time and from one thread, whatever the number of open episodes, so a
    model on one device needs no lock and may be compiled; only `prepare` is called from other
    threads. `serve` and `run` use the thread that called them, so the constructor runs in it, too.
    State of one episode belongs in `episode.memory`, never in `self`: episodes interleave."""

    #: Properties of the policy and the inputs that it needs: a class attribute, or set by
    #: `__init__`.
    description: Description

    @abc.abstractmethod
    def reset(self, episode: Episode) -> None:
        """Starts an episode. An open episode may be started again."""

    @abc.abstractmethod
    def infer(self, observation: Observation) -> np.ndarray:
        """Returns actions [n, 7], 0 < n <= horizon; an array [7] counts as one action.

        An action holds end-effector translation (3) and rotation (3), within -1..1, and the
        gripper, in the description's convention. Random numbers must come from `observation.rng`
        only. Retries do not call this method: the server repeats its last answer. An exception
        fails the rollout's attempt, with the exception's message, and is not counted as a failure
        of the task."""

    def infer_batch(self, observations: Sequence[Observation]) -> Sequence[np.ndarray]:
        """Answers several episodes' observations at once, in their order.

        Only called if the description's max_batch is above 1. If it raises, `infer` is called for
        each query, so that only the faulty query fails. `infer` is not called if the policy is
        stateful, because its memories may have advanced already, nor after an error that only a new
        process can recover from."""
        return [self.infer(observation) for observation in observations]

    def prepare(self, observation: Observation) -> Any:
        """Does work on an observation that needs neither the model nor `episode.memory`, such as
        decoding or resizing frames.

        Called before `infer`, which receives the result as `observation.prepared`. Calls come from
        several threads concurrently, while the model answers other queries."""
        return None

    def end(self, episode: Episode) -> None:  # noqa: B027 - most policies need nothing here
        """Called when an episode is over: it ended, was started again, or was removed after a long
        idle time or because too many were open. The server releases `episode.memory`
        afterwards, so most policies need nothing here."""

    def warm_up(self) -> None:
        """Does slow initial work, such as compiling, before the server accepts a connection.

        Unless overridden, answers synthetic observations: one, and a full batch if the policy takes
        batches. An exception stops the server before it starts."""
        _answer_synthetic(self)


class UnusableDescription(TypeError):
    """A policy has no usable description, or lacks a method that the server calls."""


#: Methods that the server calls, with the names of their arguments.
_CALLS = {
    "reset": ("episode",),
    "infer": ("observation",),
    "infer_batch": ("observations",),
    "prepare": ("observation",),
    "end": ("episode",),
    "warm_up": (),
}


def require_methods(policy_class: type[Policy]) -> None:
    """Checks that the server can call every method of a class. Raises UnusableDescription,
    whose message names the method and the line to write."""
    name = policy_class.__name__
    for method, arguments in _CALLS.items():
        line = f"`def {method}({', '.join(('self', *arguments))})`"
        function = getattr(policy_class, method, None)
        if method in getattr(policy_class, "__abstractmethods__", ()):
            raise UnusableDescription(f"policy {name} has no method {method!r}: write {line}")
        if not callable(function):
            raise UnusableDescription(f"{method!r} of policy {name} is not a method: write {line}")
        if inspect.iscoroutinefunction(function):
            raise UnusableDescription(
                f"method {method!r} of policy {name} is a coroutine, and the server calls plain"
                f" functions: write {line}"
            )
        kind = inspect.getattr_static(policy_class, method)
        implied = () if isinstance(kind, (staticmethod, classmethod)) else (policy_class,)
        try:
            signature = inspect.signature(function)
        except ValueError:  # A method written in C may have no signature.
            continue
        try:
            signature.bind(*implied, *arguments)
        except TypeError:
            raise UnusableDescription(
                f"method {method!r} of policy {name} takes {signature}, and the server calls"
                f" {method}({', '.join(arguments)}): write {line}"
            ) from None


def description_of(policy: Policy) -> Description:
    """Returns a policy's description. Raises UnusableDescription, also if the
    policy's methods cannot be called."""
    name = type(policy).__name__
    if not isinstance(policy, Policy):
        remedy = " (create one: MyPolicy(), not MyPolicy)" if isinstance(policy, type) else ""
        raise UnusableDescription(
            f"{policy!r} is not a policy: give an instance of a subclass of"
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


def _answer_synthetic(policy: Policy) -> None:
    """Makes a policy answer a synthetic observation and, if it takes batches, a full batch of them.
    The episodes are ended afterwards.

    A policy that refuses an episode of every suite is not warmed up, and a warning is logged: it
    may accept only tasks that `fake.TASKS` lacks. Propagates exceptions of the policy's methods;
    raises UnusableActions."""
    description = policy.description
    sizes = sorted({1, description.max_batch})
    episodes: list[Episode] = []
    try:
        for at in range(sizes[-1]):
            episode = _begin_episode(policy, at)
            if episode is None:
                return
            episodes.append(episode)
        for size in sizes:
            # In the batch, the first episode sends query 1: its query 0 was the single query.
            queries = [
                fake_observation(description, at, int(size > 1 and at == 0), episode)
                for at, episode in enumerate(episodes[:size])
            ]
            queries = [replace(query, prepared=policy.prepare(query)) for query in queries]
            answers = [policy.infer(queries[0])] if size == 1 else policy.infer_batch(queries)
            for answer in answers:
                read_actions(answer, description.horizon)
    finally:
        for episode in episodes:
            policy.end(episode)


def _begin_episode(policy: Policy, seed: int) -> Episode | None:
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
        "policy %r is not warmed up, because it refuses a synthetic episode of every suite (%s);"
        " its first answer may be slow",
        policy.description.name,
        "; ".join(refusals),
    )
    return None
