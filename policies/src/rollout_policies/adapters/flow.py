"""Policies that turn noise into a chunk of actions, one chunk per query, and keep no state between
queries: SmolVLA and π0.5, as lerobot runs them, and the base of VLA-JEPA.

SmolVLA resizes frames with padding to 512 x 512, and a chunk has 50 actions. With the released
checkpoint, LIBERO-CTRL executes one of them: executing 50 or 10 lowers the success rate by twenty
points. π0.5 resizes frames with padding to 224 x 224, and writes the state into the prompt.
`lerobot/pi05_libero_base` is not fine-tuned and has no statistics of LIBERO, so it is refused."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..catalogue import Entry
from ..description import Description
from ..episode import Episode, Observation
from ..policy import Policy
from . import Options, executed_actions
from .lerobot import LerobotModel


class FlowPolicy(Policy):
    """One chunk per query, of which the first `execute` actions are executed."""

    def __init__(
        self, entry: Entry, model: LerobotModel, *, execute: int, max_batch: int = 1
    ) -> None:
        self.model = model
        self.description = Description(
            name=entry.name,
            checkpoint=model.checkpoint,
            checkpoint_digest=model.checkpoint_digest,
            parameters=model.parameters,
            cameras=model.cameras,
            state=model.fields,
            horizon=model.config.chunk_size,
            execute=execute,
            stochastic=True,
            max_batch=max_batch,
            real_time_chunking=model.chunks_in_real_time,
            settings=model.settings,
        )

    @classmethod
    def load(cls, entry: Entry, options: Options, *, kind: str, **overrides: Any) -> FlowPolicy:
        """Loads a checkpoint of a lerobot policy type; see `LerobotModel.load`."""
        model = LerobotModel.load(entry, options, kind=kind, **overrides)
        model.enable_real_time_chunking()
        config = model.config
        execute = executed_actions(
            entry, options, chunk=config.chunk_size, from_checkpoint=config.n_action_steps
        )
        return cls(entry, model, execute=execute, max_batch=options.max_batch)

    def reset(self, episode: Episode) -> None:
        """Does nothing: the instruction is sent with every query."""

    def infer(self, observation: Observation) -> np.ndarray:
        return self.infer_batch([observation])[0]

    def infer_batch(self, observations: Sequence[Observation]) -> Sequence[np.ndarray]:
        """Answers each query. Queries with actions that are executed during inference are answered
        one by one, since the network takes one delay for all queries of a call."""
        uses_under_way = self.description.real_time_chunking
        answers: dict[int, np.ndarray] = {}
        for at, observation in enumerate(observations):
            under_way = observation.under_way
            if uses_under_way and under_way is not None:
                chunks = self.model.chunks([observation], self.noise([observation]), under_way)
                answers[at] = chunks[0]
        unanswered = [at for at in range(len(observations)) if at not in answers]
        if unanswered:
            batch = [observations[at] for at in unanswered]
            answers.update(zip(unanswered, self.model.chunks(batch, self.noise(batch))))
        return [answers[at] for at in range(len(observations))]

    def noise(self, observations: Sequence[Observation]) -> np.ndarray:
        """Returns the flow's initial noise, [batch, n, width]. Each row comes from its own
        query's generator and does not depend on the other queries of the batch."""
        config = self.model.config
        shape = (config.chunk_size, config.max_action_dim)
        rows = [
            observation.rng.standard_normal(shape, dtype=np.float32) for observation in observations
        ]
        return np.stack(rows)


def load(entry: Entry, options: Options) -> Policy:
    """Loads the checkpoint; see `rollout_policies.adapters.load`."""
    return FlowPolicy.load(entry, options, kind=entry.name)
