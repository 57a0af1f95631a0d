"""gymnasium's Reacher with one fault each. Drawing is replaced: it needs no OpenGL."""

import os
import time

import gymnasium
import numpy as np


class Reacher(gymnasium.Wrapper):
    """A small picture of the joints, and success within 10 cm."""

    def __init__(self, seed: int | None = None) -> None:
        super().__init__(gymnasium.make("Reacher-v5", max_episode_steps=30))
        self.constructed_with, self.steps, self.draws = seed, 0, 0

    def reset(self, *, seed=None, options=None):
        self.steps = 0
        return super().reset(seed=seed, options=options)

    def step(self, action):
        self.steps += 1
        observation, reward, ended, truncated, info = super().step(action)
        info["is_success"] = np.linalg.norm(observation[8:10]) < 0.1
        return observation, reward, ended, truncated, info

    def render(self):
        self.draws += 1
        joints = self.unwrapped.data.qpos[:2]
        picture = np.zeros((4, 6, 3), np.uint8)
        picture[0] = (np.abs(joints[0]) * 1000) % 256
        picture[1] = (np.abs(joints[1]) * 1000) % 256
        return picture


class Unseeded(Reacher):
    def reset(self, *, seed=None, options=None):
        return super().reset(seed=1)


class Random(Reacher):
    def reset(self, *, seed=None, options=None):
        return super().reset(seed=int.from_bytes(os.urandom(4), "little"))


class Chaotic(Reacher):
    def step(self, action):
        return super().step(np.clip(action + 0.1 * (os.getpid() * time.time() % 1), -1, 1))


class Drifting(Reacher):
    def render(self):
        return super().render() + np.uint8(self.draws)


class Growing(Reacher):
    def render(self):
        return np.zeros((4, 6 + self.steps, 3), np.uint8)


class Diverging(Reacher):
    def step(self, action):
        observation, *rest = super().step(action)
        return observation * (np.nan if self.steps > 2 else 1), *rest


class Silent(Reacher):
    def step(self, action):
        *rest, _ = super().step(action)
        return *rest, {}


class Still(Reacher):
    def step(self, action):
        self.steps += 1
        return self.unwrapped._get_obs(), 0.0, False, False, {"is_success": False}


class Raising(Reacher):
    def step(self, action):
        raise RuntimeError("the arm fell off")


class Crashing(Reacher):
    def step(self, action):
        os.abort()


class Hanging(Reacher):
    def step(self, action):
        time.sleep(3600)


class DrawnAtConstruction(Reacher):
    """Repeats after construction with a seed only, like Meta-World's tasks."""

    def reset(self, *, seed=None, options=None):
        self.constructed_with, used = None, self.constructed_with
        return super().reset(seed=seed if used is None else used)
