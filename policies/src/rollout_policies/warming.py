"""The first answers of a policy, which are the slow ones, to made-up
observations."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING

from .actions import read_actions
from .fake import TASKS, fake_episode, fake_observation

if TYPE_CHECKING:
    from .episode import Episode
    from .policy import Policy

log = logging.getLogger("rollout_policies")


def answer_made_up(policy: Policy) -> None:
    """Has a policy answer a made-up observation and, if it takes batches, a full
    batch of them, in episodes that are ended again.

    A policy that accepts no episode of any suite is left cold, with a warning:
    it may know other tasks than those made up here. Raises what its `infer`
    raises, and UnusableActions.
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
    """An episode of the first suite whose task the policy accepts."""
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
