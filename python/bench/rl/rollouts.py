"""Measures rollouts of a framework with one simulator, and prints a line of JSON: `compare.py` runs
this program for each simulator in turn, with the simulator in `PYTHONPATH`.

RLinf's `LiberoEnv`; SimpleVLA-RL's loop, with a process for each environment; and the rollouts of
that loop as rows of a `TrainingEnvironment` in one process. Each class has `reset`, which starts
rollouts and executes their settling steps, `chunk`, which executes actions [environments, steps, 7]
and receives the last observation, and `close`."""

import argparse
import contextlib
import importlib.util
import json
import multiprocessing
import os
import pickle
import subprocess
import sys
import time
import types
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

# The file prepares a process for the import of RLinf's unmodified files.
sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "shim"))
from rl_rollouts import rlinf_env

# The original imports PyTorch, and does not call it in these rollouts.
if importlib.util.find_spec("torch") is None:
    sys.modules["torch"] = types.ModuleType("torch")

#: Side of a frame, pixels.
SIDE = 256
#: Settling steps at the start of a rollout of SimpleVLA-RL.
SETTLING = 10
_NO_OP = [0.0] * 6 + [-1.0]
#: Side of the matrices that the policy `card:MS` multiplies.
_MATRIX = 8192


class RLinf:
    """RLinf's `LiberoEnv`, as one of its workers runs it: rewards and metrics included.

    With `together`, `rollout_libero.rlinf` simulates all environments in this process."""

    def __init__(self, task: str, count: int, steps: int, *, together: bool) -> None:
        suite, number = task.split("/")
        self._count = count
        self._env = rlinf_env(
            count,
            together,
            suite,
            SIDE,
            task_id_filter=[int(number)],
            use_ordered_reset_state_ids=True,
            ignore_terminations=True,
            max_episode_steps=10 * steps,
        )

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
    """Processes as in SimpleVLA-RL: a new process is forked for each rollout, and sends the
    observation at the end of each chunk through a queue."""

    def __init__(self, task: str, count: int) -> None:
        # Imported before the processes are forked, as the framework does.
        from libero.libero.envs import env_wrapper  # noqa: F401

        self._task = task
        self._count = count
        self._context = multiprocessing.get_context("fork")
        self._started: list[tuple[Any, Any, Any]] = []
        self._states = len(task_files(task)[1])

    def reset(self) -> None:
        self.close()
        for at in range(self._count):
            actions, answers = self._context.Queue(), self._context.Queue()
            process = self._context.Process(
                target=_roll_out,
                args=(self._task, at % self._states, actions, answers),
                daemon=True,
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
            for camera in ("agentview_image", "robot0_eye_in_hand_image"):
                assert answer["obs"][camera].shape == (SIDE, SIDE, 3)


class Rows:
    """SimpleVLA-RL's rollouts as rows of `TrainingEnvironment`, in this process."""

    def __init__(self, task: str, count: int) -> None:
        from rollout_libero.training import Start, TrainingEnvironment

        bddl, states = task_files(task)
        self._starts = [Start(bddl, states[at % len(states)]) for at in range(count)]
        self._envs = TrainingEnvironment(count, height=SIDE, width=SIDE, settle_steps=SETTLING)

    def reset(self) -> None:
        self._envs.reset(self._starts)

    def chunk(self, actions: np.ndarray) -> None:
        observation = self._envs.step_chunk(actions).observation
        for camera in ("agentview", "robot0_eye_in_hand"):
            assert observation[camera].shape == (len(self._starts), SIDE, SIDE, 3)

    def close(self) -> None:
        self._envs.close()


def _roll_out(task: str, trial: int, actions: Any, answers: Any) -> None:
    from libero.libero.envs import OffScreenRenderEnv

    bddl, states = task_files(task)
    env = OffScreenRenderEnv(bddl_file_name=bddl, camera_heights=SIDE, camera_widths=SIDE)
    env.seed(0)
    env.reset()
    observation = env.set_init_state(states[trial])
    for _ in range(SETTLING):
        observation, *_ = env.step(_NO_OP)
    answers.put({"obs": observation})
    while (chunk := actions.get()) is not None:
        for action in chunk:
            observation, *_ = env.step(action.tolist())
        answers.put({"obs": observation})
    env.close()
    answers.put(None)


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


def measure(flags: argparse.Namespace) -> dict[str, Any]:
    """Runs rollouts with each policy. Returns the measurements of this process and of each
    policy."""
    policies = {name: policy(name) for name in flags.policies}
    # PyTorch and the accelerator's context belong to the policy, so they are loaded before the
    # environments' memory is measured.
    importlib.import_module("torch")
    memory, on_card = _pss_mib(), _card_mib()
    count, rollouts = flags.environments, _construct(flags)
    # A smooth motion in the air, [chunks, environments, steps of a chunk, 7].
    chunks = max(1, flags.steps // flags.chunk)
    phase = np.linspace(0, 3, chunks * flags.chunk)[:, None] + np.arange(7)
    moves = np.linspace(0.2, 0.4, count)[:, None, None] * np.sin(phase)
    actions = moves.reshape(count, chunks, flags.chunk, 7).swapaxes(0, 1)
    results: dict[str, Any] = {}
    try:
        # The first rollout compiles, fills caches, and starts processes.
        rollouts.reset()
        rollouts.chunk(actions[0])
        for name, answer in policies.items():
            begun = time.perf_counter()
            rollouts.reset()
            started = time.perf_counter()
            for chunk in actions:
                answer()
                rollouts.chunk(chunk)
            ended = time.perf_counter()
            results[name] = {
                "steps/s": count * chunks * flags.chunk / (ended - started),
                "trajectories/s": count / (ended - begun),
                "reset, s": started - begun,
                "PSS per environment, MiB": (_pss_mib() - memory) / count,
                "card, MiB": _card_mib() - on_card,
            }
    finally:
        rollouts.close()
    return results


def policy(name: str) -> Callable[[], None]:
    """Returns a function that blocks as long as an answer takes: `none` answers at once, `card:MS`
    multiplies matrices on the accelerator for MS milliseconds."""
    if name == "none":
        return lambda: None
    import torch

    seconds = float(name.removeprefix("card:")) / 1e3
    shape = (2, _MATRIX, _MATRIX)
    left, right = torch.randn(shape, device="cuda", dtype=torch.bfloat16)

    def answer() -> None:
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            left @ right
            torch.cuda.synchronize()

    answer()
    return answer


def _construct(flags: argparse.Namespace) -> Any:
    if flags.framework == "rlinf":
        return RLinf(flags.task, flags.environments, flags.steps, together=flags.arm == "V")
    return (Rows if flags.arm == "V" else SimpleVLA)(flags.task, flags.environments)


def _pss_mib() -> float:
    """Returns the memory of this process and its descendants, shared pages counted once, MiB."""
    parents, total = {}, 0
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            parents[status.parent] = int(status.read_text().rpartition(")")[2].split()[1])
    processes = [Path(f"/proc/{os.getpid()}")]
    for process in processes:
        processes += [child for child, parent in parents.items() if parent == int(process.name)]
        with contextlib.suppress(OSError):
            words = (process / "smaps_rollup").read_text().split()
            total += int(words[words.index("Pss:") + 1])
    return total / 1024


def _card_mib() -> float:
    """Returns the memory in use on the first accelerator, MiB; 0 without one."""
    command = ["nvidia-smi", "--id=0", "--query-gpu=memory.used", "--format=csv,noheader,nounits"]
    try:
        return float(subprocess.check_output(command, text=True))
    except (OSError, subprocess.CalledProcessError):
        return 0.0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("framework", choices=["rlinf", "simplevla"])
    parser.add_argument("arm", choices=["O", "S", "V"])
    parser.add_argument("task")
    for option in ("environments", "chunk", "steps"):
        parser.add_argument(f"--{option}", type=int, required=True)
    parser.add_argument("--policies", nargs="+", required=True)
    print(json.dumps(measure(parser.parse_args())), flush=True)
