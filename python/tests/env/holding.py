"""A task without physics: a point that has to hold still. Each class has one fault, once."""

import os
import pathlib
import signal
import time

import gymnasium
import numpy as np

#: Control steps until success, and the distance that the point may move.
STEPS, NEAR = 3, 0.01


def first(fault: str) -> bool:
    """Returns true once for each fault, whatever process asks."""
    try:
        pathlib.Path(os.environ["MARKERS"], fault).touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


class Hold(gymnasium.Env):
    metadata = {"render_fps": 20, "perturb": ["camera"]}
    observation_space = gymnasium.spaces.Dict(
        agentview=gymnasium.spaces.Box(0, 255, (6, 8, 3), np.uint8),
        front=gymnasium.spaces.Box(0, 255, (6, 8, 3), np.uint8),
        position=gymnasium.spaces.Box(-np.inf, np.inf, (2,)),
    )
    action_space = gymnasium.spaces.Box(-1, 1, (3,))
    task_description = "hold still"
    _max_episode_steps = 6

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.grey = (options or {}).get("perturb", {}).get("camera", {}).get("grey", 128)
        self.start = self.np_random.uniform(-1, 1, 2)
        self.position, self.steps = self.start.copy(), 0
        return self.observation(), {}

    def observation(self):
        grey = np.full((6, 8, 3), self.grey, np.uint8)
        return {"agentview": grey, "front": grey, "position": self.position}

    def step(self, action):
        self.steps += 1
        self.position = self.position + 0.1 * action[:2]
        held = np.linalg.norm(self.position - self.start) < NEAR
        info = {"is_success": bool(held and self.steps >= STEPS)}
        return self.observation(), 0.0, False, self.steps >= self._max_episode_steps, info


class Killed(Hold):
    def step(self, action):
        if first("killed"):
            os.kill(os.getpid(), signal.SIGKILL)
        return super().step(action)


class Hanging(Hold):
    def step(self, action):
        if first("hanging"):
            time.sleep(600)
        return super().step(action)


class Reshaped(Hold):
    def observation(self):
        if self.steps and first("reshaped"):
            self.position = np.append(self.position, 0.0)
        return super().observation()


class Unseeded(Hold):
    def reset(self, *, seed=None, options=None):
        return super().reset(seed=int.from_bytes(os.urandom(4), "little"), options=options)
