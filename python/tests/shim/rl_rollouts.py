"""Rolls out with the unmodified files of RLinf: `rl_rollouts.py RUN OUT`."""

import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import logging
import os
import pickle
import sys
import types
from typing import Any
from unittest.mock import MagicMock

import numpy as np

SUITE, SIZE = "libero_spatial", 64
Rollouts = dict[str, Any]
#: Packages for policies and training that RLinf's files import but do not call here.
_REPLACED = (
    *("codetiming", "cv2", "draccus", "h5py", "hydra", "imageio", "matplotlib", "natsort", "ray"),
    *("pandas", "robosuite", "tensordict", "tensorflow", "termcolor", "tqdm", "transformers"),
)


class _StandIns(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Replaces the packages of ``_REPLACED`` that are not installed. Python asks this finder
    last."""

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        if name.partition(".")[0] in _REPLACED:
            return importlib.machinery.ModuleSpec(name, self, is_package=True)
        return None

    def create_module(self, spec: Any) -> types.ModuleType:
        module = types.ModuleType(spec.name)
        module.__getattr__ = lambda name: MagicMock() if name[:2] != "__" else _absent(name)  # type: ignore[method-assign]
        return module

    def exec_module(self, module: types.ModuleType) -> None:
        pass


def _absent(name: str) -> Any:
    raise AttributeError(name)


# Spawned processes import this file too, so they get the same finder.
sys.meta_path.append(_StandIns())


def rlinf_env(count: int, together: bool, suite: str, size: int, **settings: Any) -> Any:
    """Returns RLinf's `LiberoEnv`. If `together`, `rollout_libero.rlinf` simulates all environments
    in this process."""
    from omegaconf import OmegaConf

    # RLinf's own logger needs Ray.
    log = types.ModuleType("rlinf.utils.logging")
    log.get_logger = lambda *_: logging.getLogger("rlinf")  # type: ignore[attr-defined]
    sys.modules["rlinf.utils.logging"] = log
    module = importlib.import_module("rlinf.envs.libero.libero_env")
    if together:
        importlib.import_module("rollout_libero.rlinf").register()
    cfg = {
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
        "init_params": {"camera_heights": size, "camera_widths": size},
        **settings,
    }
    return module.LiberoEnv(OmegaConf.create(cfg), count, 0, 1, None)


def rlinf(together: bool = False, suite: str = SUITE, **settings: Any) -> Rollouts:
    """Runs two resets, with two chunks each, of two environments."""
    import torch

    env = rlinf_env(2, together, suite, SIZE, **settings)
    is_filmed = "video_cfg" in settings
    rng = np.random.default_rng(2)
    outputs: list[Any] = []
    for _ in range(2):
        env.is_start = True
        observation, _ = env.reset()
        outputs.append(observation)
        for _ in range(2):
            chunk = torch.from_numpy(rng.uniform(-1, 1, (2, 8, 7)).astype(np.float32))
            *results, infos = env.chunk_step(chunk)
            observed = results[0] if is_filmed else results[0][-1]
            outputs.append([observed, *results[1:], infos[-1].get("episode")])
            outputs.append(len(results[0]))
        env.update_reset_state_ids()
    env.env.close()
    tasks = [str(task) for task in env.task_descriptions]
    return {"outputs": as_arrays(outputs), "tasks": tasks}


def rlinf_plus(together: bool = False) -> Rollouts:
    """Runs `rlinf` with variants of LIBERO-Plus. Their placements and corruptions draw from the
    same generator."""
    # RLinf reads this variable when its modules are imported; its processes inherit the variable.
    os.environ["LIBERO_TYPE"] = "plus"
    from liberoplus.liberoplus import benchmark

    names = benchmark.get_benchmark("libero_goal")().get_task_names()
    bowl = "put_the_bowl_on_the_plate"
    changes = (
        "view_0_0_100_0_0_initstate_0_noise_39",
        "view_0_0_100_0_0_initstate_0_noise_50",
        "view_0_0_100_0_0_initstate_409",
        "moved_level1_sample1",
    )
    chosen = [names.index(f"{bowl}_{change}") for change in changes]
    return rlinf(
        together,
        suite="libero_goal",
        task_id_filter=chosen,
        use_fixed_reset_state_ids=False,
        auto_reset=True,
    )


def as_arrays(value: Any) -> Any:
    if hasattr(value, "detach"):
        return value.detach().cpu().numpy()
    if isinstance(value, dict):
        return {key: as_arrays(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [as_arrays(item) for item in value]
    return value


#: Settings of RLinf by the name of a run; the name with `_together` is a run in one process.
RLINF: dict[str, dict[str, Any]] = {
    "rlinf": {},
    "rlinf_auto_reset": {"auto_reset": True},
    "rlinf_evaluated": {"auto_reset": True, "is_eval": True, "use_rel_reward": False},
    "rlinf_recorded": {"video_cfg": {"save_video": True}},
    # The tasks of all suites, numbered consecutively in the suites' order.
    "rlinf_of_130": {"suite": "libero_130"},
}

if __name__ == "__main__":
    run, out = sys.argv[1:]
    name = run.removesuffix("_together")
    together = name != run
    plus = name == "rlinf_plus"
    rollouts = rlinf_plus(together) if plus else rlinf(together, **RLINF[name])
    with open(out, "wb") as file:
        pickle.dump(rollouts, file)
