"""Meta-World's scripted experts through the pipe: success by task, and their demonstrations.

    python metaworld_experts.py [--tasks NAME,…] [--seeds N] [--processes N] [--record FILE.npz]

`rollout-env calibrate` reads the recorded file.
"""

import argparse
import concurrent.futures
import sys

import numpy as np
from metaworld.policies import ENV_POLICY_MAP

from rollout_env import Client

OPTIONS = ["--action", "x,y,z,gripper"]
#: The experts read all of the observation; the first three numbers are the hand's position, m.
OPTIONS += ["--state", "all=observation", "--state", "eef_pos=observation[0:3]"]


def serve(tasks: str) -> Client:
    """Starts the simulator of these tasks."""
    spec = ["gym:Meta-World/MT1", "--tasks", f"env_name={tasks}", *OPTIONS]
    return Client([sys.executable, "-m", "rollout_env", "serve", *spec])


def rollout(pipe: Client, task: str, seed: int) -> tuple[bool, np.ndarray]:
    """Returns success, and the expert's actions."""
    steps = {one["name"]: one["max_steps"] for one in pipe.description["tasks"]}[task]
    policy = ENV_POLICY_MAP[task]()
    answer = pipe.reset(task, seed, [])
    actions = []
    while len(actions) < steps and not answer.get("success") and not answer.get("ended"):
        action = policy.get_action(np.array(answer["state"]["all"]))
        actions.append(np.clip(action, -1, 1))
        answer = pipe.step([actions[-1].tolist()], frames=False)
    return bool(answer["success"]), np.array(actions)


def task_rollouts(task: str, seeds: int) -> list[tuple[bool, np.ndarray]]:
    """Runs the seeds of one task in a simulator of its own."""
    with serve(task) as pipe:
        return [rollout(pipe, task, seed) for seed in range(seeds)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", default=",".join(sorted(ENV_POLICY_MAP)))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--record", metavar="FILE")
    options = parser.parse_args()
    tasks = options.tasks.split(",")
    recorded, successes = {}, 0
    with concurrent.futures.ThreadPoolExecutor(options.processes) as pool:
        results = pool.map(task_rollouts, tasks, [options.seeds] * len(tasks))
        for task, runs in zip(tasks, results):
            successes += sum(success for success, _ in runs)
            print(f"{task:28} {sum(success for success, _ in runs)}/{len(runs)}", flush=True)
            recorded.update({f"{task}@{seed}": run[1] for seed, run in enumerate(runs) if run[0]})
    print(f"{'all':28} {successes}/{len(tasks) * options.seeds}")
    if options.record:
        np.savez(options.record, **recorded)


if __name__ == "__main__":
    main()
