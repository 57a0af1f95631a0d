"""Time of the pipe against stepping the environment in-process, in turn in one run.

    MUJOCO_GL=egl python python/bench/pipe.py [--rounds N] [--steps N] SPEC [OPTION ...]

Each round runs the same rollout on both sides, step by step in alternating order; every step
observes all cameras. Prints the lower quartiles of the steps' wall times, which other processes of
the machine disturb least, and their ratio. Construction is not counted: it is the same.
"""

import argparse
import statistics
import sys
import time

import numpy as np

from rollout_env import Client, open_simulator
from rollout_env.settings import arguments, settings

SEED = 3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=20)
    arguments(parser)
    options = parser.parse_args()
    given = sys.argv[sys.argv.index(options.spec) :]
    simulator = open_simulator(settings(options))
    about = simulator.description
    task, cameras = about.tasks[0].name, about.cameras
    actions = np.random.default_rng(0).uniform(-1, 1, (options.steps, len(about.action)))
    times: dict[str, list[float]] = {"in-process": [], "pipe": []}
    with Client([sys.executable, "-m", "rollout_env", "serve", *given]) as pipe:
        for _ in range(options.rounds):
            simulator.reset(task, SEED, {})
            pipe.reset(task, SEED, cameras)
            for index, action in enumerate(actions):
                for side in list(times) if index % 2 else list(times)[::-1]:
                    started = time.perf_counter()
                    if side == "pipe":
                        pipe.step([action.tolist()])
                        pipe.frames()
                    else:
                        simulator.step(action)
                        simulator.observe(cameras)
                    times[side].append((time.perf_counter() - started) * 1000)
    quartiles = {side: statistics.quantiles(values)[0] for side, values in times.items()}
    sizes = ", ".join(f"{camera.width}×{camera.height}" for camera in cameras)
    for side, milliseconds in quartiles.items():
        print(f"{side}: {milliseconds:.2f} ms a step with cameras of {sizes}")
    print(f"pipe / in-process: {quartiles['pipe'] / quartiles['in-process']:.3f}")


if __name__ == "__main__":
    main()
