"""Meta-World's scripted experts as a policy. They read the whole observation and no picture.

    python experts.py --listen 127.0.0.1:5000
"""

import re
from importlib.metadata import version

import numpy as np
from metaworld.policies import ENV_POLICY_MAP

from rollout_policies import Description, Episode, Language, Observation, Policy, run

#: Experts by the instruction: the words of the task's name, as `rollout-env` describes it.
EXPERTS = {
    re.sub("[-_]+", " ", re.sub(r"-v\d+$", "", task)): expert
    for task, expert in ENV_POLICY_MAP.items()
}


class Experts(Policy):
    """Serves the expert of each task."""

    description = Description(
        name="metaworld-experts",
        checkpoint=f"metaworld {version('metaworld')}",
        readings=("all",),
        language=Language.CANONICAL_ONLY,
        stateful=True,
    )

    def reset(self, episode: Episode) -> None:
        episode.memory = EXPERTS[episode.instruction]()

    def infer(self, observation: Observation) -> np.ndarray:
        action = observation.episode.memory.get_action(observation.readings["all"])
        x, y, z, gripper = np.clip(action, -1, 1)
        return np.array([x, y, z, 0, 0, 0, gripper])


if __name__ == "__main__":
    run(Experts)
