"""Rolls out with the unmodified files of a reinforcement-learning framework:
`rl_rollouts.py FRAMEWORK OUT`.

For a framework that is in no package index, `FRAMEWORK_SOURCES` names the folder of a checkout."""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import logging
import multiprocessing
import os
import pickle
import sys
import time
import types
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np

SUITE, SIZE = "libero_spatial", 64
Rollouts = dict[str, Any]
SOURCES = Path(os.environ.get("FRAMEWORK_SOURCES") or ".")
#: Packages for policies and training that the frameworks' files import but do not call here.
_REPLACED = (
    *("codetiming", "draccus", "h5py", "hydra", "imageio", "matplotlib", "natsort", "ray"),
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


class _PlainFolders(importlib.abc.MetaPathFinder):
    """Finds frameworks' packages as plain folders, because their __init__ imports training code."""

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        if name.partition(".")[0] not in ("ript", "siirl", "verl_vla"):
            return None
        for root in (SOURCES, SOURCES / "src"):
            folder = root / name.replace(".", "/")
            if folder.is_dir():
                spec = importlib.machinery.ModuleSpec(name, None, is_package=True)
                spec.submodule_search_locations = [str(folder)]
                return spec
        return None


# Spawned processes import this file too, so they get the same finders.
sys.meta_path.insert(0, _PlainFolders())
sys.meta_path.append(_StandIns())


def rlinf(together: bool = False, suite: str = SUITE, **settings: Any) -> Rollouts:
    """Runs two resets, with two chunks each, of two environments."""
    import torch
    from omegaconf import OmegaConf

    # RLinf's own logger needs Ray.
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
    rng = np.random.default_rng(2)
    outputs: list[Any] = []
    start = time.perf_counter()
    for _ in range(2):
        env.is_start = True
        observation, _ = env.reset()
        outputs.append(observation)
        for _ in range(2):
            chunk = torch.from_numpy(rng.uniform(-1, 1, (2, 8, 7)).astype(np.float32))
            *results, infos = env.chunk_step(chunk)
            observed = results[0] if cfg.video_cfg.save_video else results[0][-1]
            outputs.append([observed, *results[1:], infos[-1].get("episode")])
            outputs.append(len(results[0]))
        env.update_reset_state_ids()
    seconds = time.perf_counter() - start
    env.env.close()
    tasks = [str(task) for task in env.task_descriptions]
    return {"outputs": as_arrays(outputs), "tasks": tasks, "seconds": seconds}


def rlinf_of_130() -> Rollouts:
    """Runs `rlinf` with the tasks of all suites, numbered consecutively in the suites' order."""
    return rlinf(suite="libero_130", specific_reset_id=None)


def rlinf_together() -> Rollouts:
    """Runs `rlinf` with all environments in one process."""
    return rlinf(together=True)


def rlinf_auto_reset() -> Rollouts:
    return rlinf(auto_reset=True)


def rlinf_auto_reset_together() -> Rollouts:
    return rlinf(together=True, auto_reset=True)


def rlinf_evaluated() -> Rollouts:
    return rlinf(auto_reset=True, is_eval=True, use_rel_reward=False)


def rlinf_evaluated_together() -> Rollouts:
    return rlinf(together=True, auto_reset=True, is_eval=True, use_rel_reward=False)


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


def rlinf_plus_together() -> Rollouts:
    return rlinf_plus(together=True)


def _task(i: int) -> tuple[str, Any]:
    from libero.libero import benchmark

    suite = benchmark.get_benchmark_dict()[SUITE]()
    return suite.get_task_bddl_file_path(i), suite.get_task_init_states(i)


class _Construct:
    """A constructor of an environment that can be sent to any process."""

    def __init__(self, i: int) -> None:
        self.arguments = {
            "bddl_file_name": _task(i)[0],
            "camera_heights": SIZE,
            "camera_widths": SIZE,
        }

    def __call__(self) -> Any:
        from libero.libero.envs import OffScreenRenderEnv

        return OffScreenRenderEnv(**self.arguments)


def simplevla_rl() -> Rollouts:
    """Runs the framework's rollout process, forked from a process that has imported LIBERO."""
    from libero.libero.envs import OffScreenRenderEnv  # noqa: F401

    rollout = importlib.import_module("verl.workers.rollout.rob_rollout")
    context = multiprocessing.get_context("fork")
    actions, answers = context.Queue(), context.Queue()
    config = SimpleNamespace(model_family="openvla", num_steps_wait=10)
    arguments = (SUITE, 2, 5, config, actions, answers, False, 0, 24)
    process = context.Process(target=rollout.env_worker, args=arguments, daemon=True)
    start = time.perf_counter()
    process.start()
    outputs = [answers.get(timeout=120)]
    rng = np.random.default_rng(4)
    while outputs[-1]["active"]:
        actions.put(rng.uniform(-1, 1, (8, 7)))
        outputs.append(answers.get(timeout=120))
    seconds = time.perf_counter() - start
    actions.put(None)
    assert answers.get(timeout=60) == {"type": "terminate"}
    process.join(timeout=60)
    return {"outputs": outputs, "tasks": [outputs[0]["task_description"]], "seconds": seconds}


def _roll_out_vector(venv: Any, kind: str, reconfigured: bool = False) -> Rollouts:
    """Steps two environments, then resets and steps the second again; its new observation replaces
    its earlier one. `reconfigured`: gives the second environment another task before this reset."""
    envs = getattr(venv, kind)([_Construct(i) for i in (0, 3)])
    states = [_task(0)[1][1], _task(3)[1][2]]
    envs.seed(4)
    envs.reset()
    outputs = [envs.set_init_state(states)]
    start = time.perf_counter()
    moves = np.random.default_rng(4).uniform(-1, 1, (3, 2, 7))
    for action in moves:
        observations, rewards, dones, infos = envs.step(action.tolist())
    assert isinstance(observations, np.ndarray) and observations.dtype == object
    seconds = time.perf_counter() - start
    if reconfigured:
        envs.reconfigure_env_fns([{**_Construct(5).arguments, "seed": 9}], id=[1])
    envs.reset(id=[1])
    states[1] = _task(5 if reconfigured else 3)[1][4]
    renewed = envs.set_init_state(init_state=[states[1]], id=[1])
    renewed, *_ = envs.step(action=[[0.0] * 6 + [-1.0]], id=[1])
    observations[[1]] = renewed
    outputs += [observations, rewards, dones, [dict(info) for info in infos]]
    envs.close()
    return {"outputs": outputs, "tasks": [], "seconds": seconds}


def verl_vla() -> Rollouts:
    return _roll_out_vector(
        importlib.import_module("verl_vla.envs.libero.venv"),
        "ReconfigureSubprocEnv",
        reconfigured=True,
    )


def vlarl() -> Rollouts:
    return _roll_out_vector(importlib.import_module("ppo.envs.venv"), "SubprocVectorEnv")


def siirl() -> Rollouts:
    return _roll_out_vector(
        importlib.import_module("siirl.environment.embodied.venv"), "SubprocVectorEnv"
    )


def ript_vla() -> Rollouts:
    """Runs wrappers of one environment and of several, with `reset_ori` and `reset`."""
    utils = importlib.import_module("ript.utils.libero_utils")
    from libero.libero import benchmark

    names = {"agentview_rgb": "agentview_image", "gripper_states": "robot0_gripper_qpos"}
    meta = {"observation": {"rgb": ["agentview_rgb"], "lowdim": {"gripper_states": 2}}}
    suite = benchmark.get_benchmark(SUITE)()

    def construct() -> Any:
        return utils.LiberoWrapper(1, suite, meta, names, SIZE, SIZE, device="cpu")

    outputs: list[Any] = []
    start = time.perf_counter()
    for count in (1, 2):
        envs = utils.LiberoVectorWrapper(construct, count)
        assert envs.action_space.shape == (count, 7)
        states = _task(1)[1][:count]
        for reset in (envs.reset_ori, envs.reset):
            outputs.append(reset(states)[0])
            outputs.append(list(envs.step(np.full((count, 7), 0.3))))
        pictures = envs.render()
        assert [picture.shape for picture in pictures] == [(SIZE, SIZE, 3)] * count
        envs._env.close()
    seconds = time.perf_counter() - start
    return {"outputs": as_arrays(outputs), "tasks": [], "seconds": seconds}


def rlinf_recorded() -> Rollouts:
    return rlinf(video_cfg={"save_video": True})


def rlinf_recorded_together() -> Rollouts:
    return rlinf(together=True, video_cfg={"save_video": True})


def as_arrays(value: Any) -> Any:
    if hasattr(value, "detach"):
        return value.detach().cpu().numpy()
    if isinstance(value, dict):
        return {key: as_arrays(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [as_arrays(item) for item in value]
    return value


FRAMEWORKS: dict[str, Callable[[], Rollouts]] = {
    framework.__name__: framework
    for framework in (
        rlinf,
        rlinf_together,
        rlinf_of_130,
        rlinf_auto_reset,
        rlinf_auto_reset_together,
        rlinf_evaluated,
        rlinf_evaluated_together,
        rlinf_recorded,
        rlinf_recorded_together,
        rlinf_plus,
        rlinf_plus_together,
        simplevla_rl,
        verl_vla,
        vlarl,
        siirl,
        ript_vla,
    )
}

if __name__ == "__main__":
    framework, out = sys.argv[1:]
    sys.path[:0] = filter(None, [os.environ.get("FRAMEWORK_SOURCES")])
    rollouts = FRAMEWORKS[framework]()
    with open(out, "wb") as file:
        pickle.dump(rollouts, file)
