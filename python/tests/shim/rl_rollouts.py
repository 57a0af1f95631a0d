"""Rollouts of a framework for reinforcement learning, its own files unmodified:
`rl_rollouts.py FRAMEWORK OUT`.

`FRAMEWORK_SOURCES` names a folder with a checkout of it where the package index has none.
"""

from __future__ import annotations

import importlib
import logging
import os
import pickle
import sys
import time
import types
from collections.abc import Callable
from typing import Any

import numpy as np

SUITE, SIZE = "libero_spatial", 64
Rollouts = dict[str, Any]


def rlinf(together: bool = False, suite: str = SUITE, **settings: Any) -> Rollouts:
    """Two resets, two chunks each, of two environments."""
    import torch
    from omegaconf import OmegaConf

    # Its logger is Ray's.
    log = types.ModuleType("rlinf.utils.logging")
    log.get_logger = lambda *_: logging.getLogger("rlinf")  # type: ignore[attr-defined]
    sys.modules["rlinf.utils.logging"] = log
    module = importlib.import_module("rlinf.envs.libero.libero_env")
    if together:
        importlib.import_module("rollout_libero.rlinf").register()
    cfg = OmegaConf.create(
        {
            "task_suite_name": suite,
            "seed": 11,
            "group_size": 1,
            "use_fixed_reset_state_ids": True,
            "use_ordered_reset_state_ids": False,
            "specific_reset_id": None,
            "ignore_terminations": False,
            "auto_reset": False,
            "is_eval": False,
            "use_rel_reward": True,
            "use_step_penalty": False,
            "reward_coef": 1.0,
            "max_episode_steps": 16,
            "reset_gripper_open": True,
            "video_cfg": {"save_video": False},
            "init_params": {"camera_heights": SIZE, "camera_widths": SIZE},
            **settings,
        }
    )
    env = module.LiberoEnv(cfg, 2, 0, 1, None)
    chance = np.random.default_rng(2)
    seen: list[Any] = []
    begun = time.perf_counter()
    for _ in range(2):
        env.is_start = True
        observation, _ = env.reset()
        seen.append(observation)
        for _ in range(2):
            chunk = torch.from_numpy(chance.uniform(-1, 1, (2, 8, 7)).astype(np.float32))
            *results, infos = env.chunk_step(chunk)
            seen.append([results[0][-1], *results[1:], infos[-1].get("episode")])
            seen.append(len(results[0]))
        env.update_reset_state_ids()
    took = time.perf_counter() - begun
    env.env.close()
    tasks = [str(task) for task in env.task_descriptions]
    return {"seen": as_arrays(seen), "tasks": tasks, "seconds": took}


def rlinf_of_130() -> Rollouts:
    """Tasks of all suites together, counted through the suites' order."""
    return rlinf(suite="libero_130", specific_reset_id=None)


def rlinf_together() -> Rollouts:
    """The same as `rlinf` in one process."""
    return rlinf(together=True)


def rlinf_auto_reset() -> Rollouts:
    return rlinf(auto_reset=True)


def rlinf_auto_reset_together() -> Rollouts:
    return rlinf(together=True, auto_reset=True)


def rlinf_evaluated() -> Rollouts:
    return rlinf(auto_reset=True, is_eval=True, use_rel_reward=False)


def rlinf_evaluated_together() -> Rollouts:
    return rlinf(together=True, auto_reset=True, is_eval=True, use_rel_reward=False)


def as_arrays(value: Any) -> Any:
    if hasattr(value, "detach"):
        return value.detach().cpu().numpy()
    if isinstance(value, dict):
        return {key: as_arrays(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [as_arrays(one) for one in value]
    return value


FRAMEWORKS: dict[str, Callable[[], Rollouts]] = {
    work.__name__: work
    for work in (
        rlinf,
        rlinf_together,
        rlinf_of_130,
        rlinf_auto_reset,
        rlinf_auto_reset_together,
        rlinf_evaluated,
        rlinf_evaluated_together,
    )
}

if __name__ == "__main__":
    framework, out = sys.argv[1:]
    sys.path[:0] = filter(None, [os.environ.get("FRAMEWORK_SOURCES")])
    rollouts = FRAMEWORKS[framework]()
    with open(out, "wb") as file:
        pickle.dump(rollouts, file)
