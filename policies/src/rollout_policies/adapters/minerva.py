"""MINERVA, whose repository is its own version of lerobot.

It has no language model: it finds the instruction in a table of LIBERO's 40 tasks, and any other
wording is an error. Its description therefore declares canonical instructions only. The language
axis does not change its input, so its results on that axis say nothing about language.

Its input is the last two observations, and it is queried at every step; it averages the overlapping
chunks itself, with weights exp(-0.01 i)."""

from __future__ import annotations

import numpy as np

from ..catalogue import Entry
from ..description import Description, Language
from ..episode import Episode, Observation
from ..policy import Policy
from . import Options, executed_actions
from .lerobot import LerobotModel

#: The authors' protocol: a query at every step, and the rate of the exponential chunk weights.
EXECUTE = 1
ENSEMBLE = 0.01


class Minerva(Policy):
    """One action per query, averaged from the current and earlier chunks."""

    def __init__(self, entry: Entry, model: LerobotModel) -> None:
        self.model = model
        self.description = Description(
            name=entry.name,
            checkpoint=model.checkpoint,
            checkpoint_digest=model.checkpoint_digest,
            parameters=model.parameters,
            cameras=model.cameras,
            state=model.fields,
            horizon=EXECUTE,
            stateful=True,
            language=Language.CANONICAL_ONLY,
            settings={
                **model.settings,
                "chunk": "averaged to 1",
                "ensemble": f"exp(-{ENSEMBLE} i)",
            },
        )

    def reset(self, episode: Episode) -> None:
        episode.memory = self.model.fresh_memory()

    def infer(self, observation: Observation) -> np.ndarray:
        return self.model.act(observation, observation.episode.memory)


def load(entry: Entry, options: Options) -> Policy:
    """Loads the checkpoint; see `rollout_policies.adapters.load`."""
    executed_actions(entry, options, chunk=EXECUTE, from_checkpoint=EXECUTE)
    model = LerobotModel.load(
        entry, options, n_action_steps=EXECUTE, temporal_ensemble_coeff=ENSEMBLE
    )
    return Minerva(entry, model)
