"""Rollouts of frameworks: RLinf's own `LiberoEnv`, and a loop like SimpleVLA-RL's."""

from __future__ import annotations

import importlib
import multiprocessing
from pathlib import Path
from typing import Any, Protocol

import numpy as np

SIDE = 256
#: Steps of settling in each framework.
SETTLING = {"rlinf": 15, "simplevla": 10}
_NOTHING = [0.0] * 6 + [-1.0]


class Rollouts(Protocol):
    """Environments of a framework."""

    def reset(self) -> None:
        """Starts a rollout in each environment, settling included."""

    def chunk(self, actions: np.ndarray) -> None:
        """Executes actions, [environments, steps, 7], up to the policy's next observation."""

    def close(self) -> None:
        """Ends all processes."""


class RLinf:
    """RLinf's `LiberoEnv`, as one of its workers runs it: rewards and metrics included."""

    def __init__(self, task: str, count: int, steps: int, *, together: bool) -> None:
        from omegaconf import OmegaConf

        module = importlib.import_module("rlinf.envs.libero.libero_env")
        if together:
            importlib.import_module("rollout_libero.rlinf").register()
        suite, number = task.split("/")
        settings = {
            "task_suite_name": suite,
            "task_id_filter": [int(number)],
            "seed": 11,
            "group_size": 1,
            "use_fixed_reset_state_ids": True,
            "use_ordered_reset_state_ids": True,
            "specific_reset_id": None,
            "ignore_terminations": True,
            "auto_reset": False,
            "is_eval": False,
            "use_rel_reward": True,
            "use_step_penalty": False,
            "reward_coef": 1.0,
            "max_episode_steps": 10 * steps,
            "reset_gripper_open": True,
            "video_cfg": {"save_video": False},
            "init_params": {"camera_heights": SIDE, "camera_widths": SIDE},
        }
        self._count = count
        self._env = module.LiberoEnv(OmegaConf.create(settings), count, 0, 1, None)

    def reset(self) -> None:
        self._env.is_start = True
        self._check(self._env.reset()[0])
        self._env.update_reset_state_ids()

    def chunk(self, actions: np.ndarray) -> None:
        import torch

        observations, *_ = self._env.chunk_step(torch.from_numpy(actions.astype(np.float32)))
        self._check(observations[-1])

    def close(self) -> None:
        self._env.env.close()

    def _check(self, observation: dict[str, Any]) -> None:
        for name in ("main_images", "wrist_images"):
            assert observation[name].shape == (self._count, SIDE, SIDE, 3)


class SimpleVLA:
    """Processes like SimpleVLA-RL's `env_worker`: a new one, forked, for each rollout, which sends
    the observation at the end of each chunk through a queue. `every_frame` reads all frames.
    """

    def __init__(self, task: str, count: int, *, every_frame: bool) -> None:
        # Imported before the processes are forked, as the framework does.
        from libero.libero.envs import OffScreenRenderEnv  # noqa: F401

        self._task = task_files(task)
        self._count = count
        self._every_frame = every_frame
        self._context = multiprocessing.get_context("fork")
        self._started: list[tuple[Any, Any, Any]] = []

    def reset(self) -> None:
        self.close()
        bddl, states = self._task
        for at in range(self._count):
            actions, answers = self._context.Queue(), self._context.Queue()
            process = self._context.Process(
                target=_roll_out,
                args=(bddl, states[at % len(states)], self._every_frame, actions, answers),
                daemon=True,
            )
            process.start()
            self._started.append((process, actions, answers))
        self._receive()

    def chunk(self, actions: np.ndarray) -> None:
        for (_, given, _), one in zip(self._started, actions, strict=True):
            given.put(one)
        self._receive()

    def close(self) -> None:
        for _, actions, _ in self._started:
            actions.put(None)
        for process, _, _ in self._started:
            process.join(timeout=60)
        self._started = []

    def _receive(self) -> None:
        for _, _, answers in self._started:
            seen = answers.get(timeout=300)
            if isinstance(seen, str):
                raise RuntimeError(f"a process of the environments: {seen}")
            for camera in ("agentview_image", "robot0_eye_in_hand_image"):
                assert seen[camera].shape == (SIDE, SIDE, 3)


def _roll_out(bddl: str, state: np.ndarray, every_frame: bool, actions: Any, answers: Any) -> None:
    from libero.libero.envs import OffScreenRenderEnv

    try:
        env = OffScreenRenderEnv(bddl_file_name=bddl, camera_heights=SIDE, camera_widths=SIDE)
        env.seed(0)
        env.reset()
        seen = env.set_init_state(state)
        for _ in range(SETTLING["simplevla"]):
            seen, *_ = env.step(_NOTHING)
            if every_frame:
                dict(seen)
        answers.put(dict(seen))
        while (chunk := actions.get()) is not None:
            for action in chunk:
                seen, *_ = env.step(action.tolist())
                if every_frame:
                    dict(seen)
            answers.put(dict(seen))
        env.close()
    except Exception as error:  # noqa: BLE001  The parent raises it.
        answers.put(f"{type(error).__name__}: {error}")


def task_files(task: str) -> tuple[str, np.ndarray]:
    """Returns the path of a task's BDDL file, and its initial states."""
    from libero.libero import benchmark, get_libero_path

    suite, number = task.split("/")
    tasks = benchmark.get_benchmark_dict()[suite]()
    one = tasks.get_task(int(number))
    bddl = Path(get_libero_path("bddl_files"), one.problem_folder, one.bddl_file)
    return str(bddl), np.asarray(tasks.get_task_init_states(int(number)))
