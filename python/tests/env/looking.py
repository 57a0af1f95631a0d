"""A policy that holds still while it sees one colour and knows its position, and else moves."""

import sys

import numpy as np

from rollout_policies import Camera, Description, Language, Policy, run


class Looking(Policy):
    description = Description(
        name="looking",
        checkpoint="test",
        cameras=(Camera("agentview", 16, 12), Camera("front", 16, 12)),
        readings=("position",),
        language=Language.IGNORED,
    )

    def reset(self, episode):
        assert episode.instruction == "hold still", episode.instruction

    def infer(self, observation):
        sees = observation.images["front"].std() < 1 and observation.readings["position"].size == 2
        return np.array([0.0 if sees else 1.0, 0, 0, 0, 0, 0, -1])


if __name__ == "__main__":
    sys.exit(run(Looking))
