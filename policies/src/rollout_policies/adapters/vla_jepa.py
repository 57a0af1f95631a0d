"""VLA-JEPA, as lerobot runs it.

Frames are reduced to 224 x 224 by area, by the model; its processor maps
minimum and maximum back and makes the gripper two-valued. Its flow takes no
noise from outside, so torch's generator is seeded before every query, and
queries are answered one by one: in a batch, neighbours would share the draw.
"""

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
    """Noise from a seeded generator."""

    def infer_batch(self, observations: Sequence[Observation]) -> Sequence[np.ndarray]:
        return [self._infer_alone(observation) for observation in observations]

    def _infer_alone(self, observation: Observation) -> np.ndarray:
        self.model.seed(seed_of(observation))
        return self.model.chunks([observation])[0]


def load(entry: Entry, options: Options) -> Policy:
    """Loads the checkpoint; see `rollout_policies.adapters.load`."""
    # The world model is there to train with.
    return VlaJepa.load(entry, options, kind="vla_jepa", enable_world_model=False)
