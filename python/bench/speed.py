"""Times the environments of the installed `libero` (the original LIBERO or the shim), and those of
`rollout_libero`. Prints one line of JSON.

usage: speed.py one|processes|threads TASK [--environments N] [--steps N]

`one`: resets and control steps of one environment, without frames and with both frames.
`processes`: environments with a process each, as the original's users run them.
`threads`: environments of rollout_libero in this process.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
import types
from collections.abc import Callable
from pathlib import Path

import numpy as np

#: Side of a frame, pixels.
SIDE = 256
#: Timed resets; an environment's first reset is not timed.
RESETS = 11
#: Untimed steps at the start.
WARM_UP = 3


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("mode", choices=["one", "processes", "threads"])
    parser.add_argument("task")
    parser.add_argument("--environments", type=int, default=16)
    parser.add_argument("--steps", type=int, default=30)
    flags = parser.parse_args()
    measured = {"one": measure_one, "processes": measure_processes, "threads": measure_threads}[
        flags.mode
    ](flags)
    print(json.dumps(measured))


def actions(count: int) -> np.ndarray:
    """Returns a smooth motion in the air, [count, 7], the same in every measurement."""
    phase = np.linspace(0, 3, count)[:, None] + np.arange(7)
    return 0.3 * np.sin(phase)


def task_files(task: str) -> tuple[str, np.ndarray]:
    """Returns the path of a task's BDDL file, and its initial states."""
    # The original imports torch, and does not call it here.
    sys.modules.setdefault("torch", types.ModuleType("torch"))
    from libero.libero import benchmark

    suite, index = task.split("/")
    tasks = benchmark.get_benchmark_dict()[suite]()
    return tasks.get_task_bddl_file_path(int(index)), init_states(tasks, int(index))


def init_states(tasks, index: int) -> np.ndarray:
    """Reads the initial states from a pickled array, which the original would load with torch."""
    import pickle
    import zipfile

    from libero.libero import get_libero_path

    task = tasks.get_task(index)
    path = Path(get_libero_path("init_states"), task.problem_folder, task.init_states_file)
    with zipfile.ZipFile(path) as archive, archive.open("archive/data.pkl") as member:
        return pickle.load(member)


def environment(bddl: str, *, frames: bool):
    """Constructs an environment as evaluation scripts do."""
    from libero.libero.envs.env_wrapper import ControlEnv

    return ControlEnv(
        bddl_file_name=bddl,
        camera_heights=SIDE,
        camera_widths=SIDE,
        use_camera_obs=frames,
        has_offscreen_renderer=frames,
        has_renderer=False,
        ignore_done=True,
    )


def median_ms(work: Callable[[], object], times: int) -> float:
    durations = []
    for _ in range(times):
        start = time.perf_counter()
        work()
        durations.append(time.perf_counter() - start)
    return statistics.median(durations) * 1e3


def measure_one(flags: argparse.Namespace) -> dict[str, float]:
    """Returns the median durations of one environment's steps and resets, ms."""
    bddl, states = task_files(flags.task)
    measured = {}
    for frames, name in ((False, "step_ms"), (True, "frames_ms")):
        env = environment(bddl, frames=frames)
        env.seed(0)
        env.reset()
        env.set_init_state(states[0])
        moves = iter(actions(flags.steps + WARM_UP))
        for _ in range(WARM_UP):
            env.step(next(moves))
        measured[name] = median_ms(lambda env=env, moves=moves: env.step(next(moves)), flags.steps)
        if frames:
            # Resets are timed only without frames, since each reset would render its observation.
            env.close()
            continue
        measured["reset_ms"] = median_ms(env.reset, RESETS)
        env.close()
    return measured


def measure_processes(flags: argparse.Namespace) -> dict[str, float]:
    """Returns observations per second of environments in processes, and mebibytes of each."""
    import multiprocessing

    from libero.libero.envs import SubprocVectorEnv

    multiprocessing.set_start_method("spawn", force=True)
    bddl, states = task_files(flags.task)
    count = flags.environments
    env = SubprocVectorEnv([_Maker(bddl)] * count)
    env.reset()
    env.set_init_state([states[0]] * count)
    rate = observations_per_second(env.step, flags.steps, count)
    memory = [pss_mib(worker.process.pid) for worker in env.workers]
    env.close()
    return {"observations_per_second": rate, "further_mib": statistics.median(memory)}


class _Maker:
    """Constructs an environment in a spawned process."""

    def __init__(self, bddl: str) -> None:
        self.bddl = bddl

    def __call__(self):
        return environment(self.bddl, frames=True)


def measure_threads(flags: argparse.Namespace) -> dict[str, float]:
    """Returns observations per second of environments in this process, and mebibytes of each."""
    import rollout_libero

    count = flags.environments
    options = {"height": SIDE, "width": SIDE, "max_steps": 10_000, "init_states": [0]}
    single = rollout_libero.VectorEnvironment(flags.task, 1, **options)
    single.reset()
    single.step(actions(1))
    before = pss_mib(os.getpid())
    env = rollout_libero.VectorEnvironment(flags.task, count, **options)
    env.reset()
    env.step(np.repeat(actions(1), count, axis=0))
    growth = (pss_mib(os.getpid()) - before) / count
    rate = observations_per_second(env.step, flags.steps, count)
    env.close()
    single.close()
    return {"observations_per_second": rate, "further_mib": growth}


def observations_per_second(step: Callable[[np.ndarray], object], steps: int, count: int) -> float:
    """Returns the rate of `count` environments that step together, after untimed steps."""
    moves = np.repeat(actions(steps + WARM_UP)[:, None], count, axis=1)
    for action in moves[:WARM_UP]:
        step(action)
    start = time.perf_counter()
    for action in moves[WARM_UP:]:
        step(action)
    return steps * count / (time.perf_counter() - start)


def pss_mib(process: int) -> float:
    """Returns the memory of a process with its proportional share of shared pages, MiB."""
    for line in Path(f"/proc/{process}/smaps_rollup").read_text().splitlines():
        if line.startswith("Pss:"):
            return int(line.split()[1]) / 1024
    raise OSError(f"failed to read the memory of process {process}: no line `Pss:`")


if __name__ == "__main__":
    main()
