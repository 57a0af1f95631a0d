"""robosuite's tasks as gymnasium environments: `gym:robosuite_tasks:make()`.

robosuite 1.5 seeds itself at construction, and reports success by a method.
"""

from typing import Any

import gymnasium
import numpy as np
import robosuite
from robosuite.wrappers import GymWrapper


class Task(gymnasium.Wrapper):
    """A robosuite task with gymnasium's conventions."""

    metadata = {"render_fps": 20}

    def step(self, action: np.ndarray) -> Any:
        """Steps, and reports success in `info`."""
        *rest, info = self.env.step(action)
        return *rest, {**info, "is_success": bool(self.unwrapped._check_success())}


def make(task: str = "Lift", seed: int | None = None, horizon: int = 500) -> gymnasium.Env:
    """Constructs a task with a Panda; frames are drawn from the model (`mujoco.agentview`)."""
    env = robosuite.make(
        task,
        robots="Panda",
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        control_freq=20,
        horizon=horizon,
        seed=seed,
    )
    wrapped = Task(GymWrapper(env, ["robot0_proprio-state", "object-state"], flatten_obs=False))
    wrapped._max_episode_steps = horizon
    return wrapped
