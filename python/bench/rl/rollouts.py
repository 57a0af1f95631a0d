"""Rollouts in frameworks: RLinf's `LiberoEnv`; SimpleVLA-RL's loop, with a process for each
environment; and the rollouts of that loop as rows of a `TrainingEnvironment` in one process."""

from __future__ import annotations

import functools
import importlib
import multiprocessing
import os
import pickle
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

#: Side of a frame, pixels.
SIDE = 256
#: Settling steps at the start of a rollout, by framework.
SETTLING = {"rlinf": 15, "simplevla": 10}
_NO_OP = [0.0] * 6 + [-1.0]


class Rollouts(Protocol):
    """Environments of a framework. `loop` names the code that runs them."""

    loop: str

    def reset(self) -> None:
        """Starts a rollout in each environment, and executes its settling steps."""

    def chunk(self, actions: np.ndarray) -> None:
        """Executes a chunk of actions, [environments, steps, 7], and receives the observation after
        the last step."""

    def close(self) -> None:
        """Ends all processes."""


class RLinf:
    """RLinf's `LiberoEnv`, as one of its workers runs it: rewards and metrics included.

    With `together`, `rollout_libero.rlinf` simulates all environments in this process."""

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
        self.loop = str(module.LiberoEnv.__module__)
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
    """Processes of SimpleVLA-RL: a new process is forked for each rollout.

    The processes send the observation at the end of each chunk through a queue. They run the
    framework's own `env_worker` if `ROLLOUT_FRAMEWORKS` names a folder with a checkout
    `SimpleVLA-RL`, otherwise `_roll_out`, the same loop. With `every_frame`, the frames of every
    step are read, not only those that are sent."""

    def __init__(self, task: str, count: int, *, every_frame: bool) -> None:
        # Imported before the processes are forked, as the framework does.
        from libero.libero.envs import env_wrapper

        self._task = task
        self._count = count
        self._context = multiprocessing.get_context("fork")
        self._started: list[tuple[Any, Any, Any]] = []
        self._states = len(task_files(task)[1])
        self._work = _env_worker()
        if every_frame:
            for method in ("reset", "set_init_state", "step"):
                _read_frames_of(env_wrapper.ControlEnv, method)

    @property
    def loop(self) -> str:
        """The loop that runs in the processes."""
        if self._work is _roll_out:
            return "a loop like SimpleVLA-RL's"
        return str(self._work.__module__)

    def reset(self) -> None:
        self.close()
        suite, number = self._task.split("/")
        config = SimpleNamespace(model_family="openvla", num_steps_wait=SETTLING["simplevla"])
        for at in range(self._count):
            actions, answers = self._context.Queue(), self._context.Queue()
            start = (suite, int(number), at % self._states, config, actions, answers)
            process = self._context.Process(
                target=_run_and_report_failure, args=(self._work, answers, *start), daemon=True
            )
            process.start()
            self._started.append((process, actions, answers))
        self._receive()

    def chunk(self, actions: np.ndarray) -> None:
        for (_, queue, _), chunk in zip(self._started, actions, strict=True):
            queue.put(chunk)
        self._receive()

    def close(self) -> None:
        for _, actions, _ in self._started:
            actions.put(None)
        for process, _, answers in self._started:
            answers.get(timeout=60)
            process.join(timeout=60)
        self._started = []

    def _receive(self) -> None:
        for _, _, answers in self._started:
            answer = answers.get(timeout=300)
            if isinstance(answer, str):
                raise RuntimeError(f"a process of an environment failed: {answer}")
            for camera in ("agentview_image", "robot0_eye_in_hand_image"):
                assert answer["obs"][camera].shape == (SIDE, SIDE, 3)


class Rows:
    """SimpleVLA-RL's rollouts as rows of `TrainingEnvironment`, in this process."""

    loop = "TrainingEnvironment"

    def __init__(self, task: str, count: int) -> None:
        from rollout_libero.training import Start, TrainingEnvironment

        bddl, states = task_files(task)
        self._starts = [Start(bddl, states[at % len(states)]) for at in range(count)]
        self._envs = TrainingEnvironment(
            count, height=SIDE, width=SIDE, settle_steps=SETTLING["simplevla"]
        )

    def reset(self) -> None:
        self._envs.reset(self._starts)

    def chunk(self, actions: np.ndarray) -> None:
        observation = self._envs.step_chunk(actions).observation
        for camera in ("agentview", "robot0_eye_in_hand"):
            assert observation[camera].shape == (len(self._starts), SIDE, SIDE, 3)

    def close(self) -> None:
        self._envs.close()


def _env_worker() -> Callable[..., None]:
    """Returns SimpleVLA-RL's `env_worker`, or `_roll_out` if there is no checkout."""
    checkout = Path(os.environ.get("ROLLOUT_FRAMEWORKS") or "/nowhere") / "SimpleVLA-RL"
    if not checkout.is_dir():
        return _roll_out
    sys.path.insert(0, str(checkout))
    work: Callable[..., None] = importlib.import_module(
        "verl.workers.rollout.rob_rollout"
    ).env_worker
    return work


def _run_and_report_failure(work: Callable[..., None], answers: Any, *start: Any) -> None:
    try:
        # Arguments: no validation, training step 0, and practically no limit of steps.
        work(*start, False, 0, 1 << 30)
    except Exception as error:
        answers.put(f"{type(error).__name__}: {error}")


def _roll_out(
    suite: str, number: int, trial: int, config: Any, actions: Any, answers: Any, *_rest: Any
) -> None:
    from libero.libero.envs import OffScreenRenderEnv

    bddl, states = task_files(f"{suite}/{number}")
    env = OffScreenRenderEnv(bddl_file_name=bddl, camera_heights=SIDE, camera_widths=SIDE)
    env.seed(0)
    env.reset()
    observation = env.set_init_state(states[trial])
    for _ in range(config.num_steps_wait):
        observation, *_ = env.step(_NO_OP)
    answers.put({"obs": observation})
    while (chunk := actions.get()) is not None:
        for action in chunk:
            observation, *_ = env.step(action.tolist())
        answers.put({"obs": observation})
    env.close()
    answers.put({"type": "terminate"})


def _read_frames_of(environment: Any, method: str) -> None:
    """Changes a method of an environment class so that it reads all frames of the observation that
    it returns."""
    call = getattr(environment, method)

    @functools.wraps(call)
    def read(*arguments: Any, **named: Any) -> Any:
        result = call(*arguments, **named)
        dict(result[0] if method == "step" else result)
        return result

    setattr(environment, method, read)


def task_files(task: str) -> tuple[str, np.ndarray]:
    """Returns the path of a task's BDDL file, and the task's initial states. LIBERO would read the
    states with PyTorch, which this function does not need."""
    from libero.libero import benchmark, get_libero_path

    suite, number = task.split("/")
    entry = benchmark.get_benchmark_dict()[suite]().get_task(int(number))
    bddl = Path(get_libero_path("bddl_files"), entry.problem_folder, entry.bddl_file)
    states = Path(get_libero_path("init_states"), entry.problem_folder, entry.init_states_file)
    with zipfile.ZipFile(states) as archive, archive.open("archive/data.pkl") as member:
        return str(bddl), np.asarray(pickle.load(member))
