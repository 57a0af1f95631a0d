"""VLA-JEPA, as lerobot runs it.

The model reduces frames to 224 x 224 by area; its processor un-normalises actions by
minimum and maximum and makes the gripper binary. Its flow takes no noise as input, so
torch's generator is seeded before every query, and queries are answered one by one:
a batch would draw all its noise from one seed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..catalogue import Entry
from ..episode import Observation
from ..policy import Policy
from . import Options
from .flow import FlowPolicy
from .upstream import seed_of


class VlaJepa(FlowPolicy):
    """A flow policy that draws its noise from torch's generator, seeded for each query."""

    def infer_batch(self, observations: Sequence[Observation]) -> Sequence[np.ndarray]:
        return [self._infer_alone(observation) for observation in observations]

    def _infer_alone(self, observation: Observation) -> np.ndarray:
        self.model.seed(seed_of(observation))
        return self.model.chunks([observation])[0]


def load(entry: Entry, options: Options) -> Policy:
    """Loads the checkpoint; see `rollout_policies.adapters.load`."""
    # The world model is used in training only.
    return VlaJepa.load(entry, options, kind="vla_jepa", enable_world_model=False)
