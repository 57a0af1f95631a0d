"""Plays an episode with a PyPI client of LIBERO: `client_episodes.py CLIENT ACTIONS OUT`.

The script runs with the shim and with the original. `CLIENT_PACKAGES` names a folder of packages,
which Python searches after its own packages."""

from __future__ import annotations

import asyncio
import os
import pickle
import sys
from collections.abc import Callable
from typing import Any

sys.path += filter(None, [os.environ.get("CLIENT_PACKAGES")])

import as_recorded  # noqa: F401
import numpy as np

SUITE, TASK = "libero_object", 0
SIZE = 128
Episode = list[dict[str, Any]]


def vla_eval(actions: np.ndarray) -> Episode:
    from vla_eval.benchmarks.libero import benchmark

    benchmark.LIBERO_ENV_RESOLUTION = SIZE
    run = benchmark.LIBEROBenchmark(suite=SUITE, seed=7, send_wrist_image=True, send_state=True)

    async def play() -> Episode:
        await run.start_episode({**run.get_tasks()[TASK], "episode_idx": 0})
        episode = [dict(await run.get_observation())]
        for action in actions:
            await run.apply_action({"actions": action})
            result = await run.get_result()
            episode.append({**await run.get_observation(), **result})
            if await run.is_done():
                break
        return episode

    episode = asyncio.run(play())
    run.cleanup()
    return episode


def lerobot(actions: np.ndarray) -> Episode:
    from lerobot.envs.libero import LiberoEnv

    from libero.libero import benchmark

    suite = benchmark.get_benchmark_dict()[SUITE]()
    env = LiberoEnv(
        suite,
        TASK,
        SUITE,
        obs_type="pixels_agent_pos",
        observation_width=SIZE,
        observation_height=SIZE,
    )
    observation, info = env.reset(seed=7)
    episode = [{**observation, **info, "task": env.task_description}]
    for action in actions:
        observation, reward, ended, truncated, info = env.step(action)
        episode.append({**observation, **info, "reward": reward, "truncated": truncated})
        if ended:
            break
    episode.append({"shown": env.render()})
    env.close()
    return episode


def torchrl(actions: np.ndarray) -> Episode:
    import torch
    from torchrl.envs import LiberoEnv

    env = LiberoEnv(
        SUITE,
        TASK,
        camera_height=SIZE,
        camera_width=SIZE,
        wrist_camera="robot0_eye_in_hand",
        init_state_mode="fixed",
        init_state_id=0,
        from_pixels=True,
    )
    env.set_seed(7)
    step = env.reset()
    episode = [as_numpy(step)]
    for action in actions:
        step["action"] = torch.as_tensor(action, dtype=torch.float32)
        step = env.step(step)["next"]
        episode.append(as_numpy(step))
        if bool(step["done"]):
            break
    env.close()
    return episode


def as_numpy(tensors: Any) -> dict[str, Any]:
    return {
        "/".join(key if isinstance(key, tuple) else (key,)): (
            value.numpy().copy() if hasattr(value, "numpy") else value
        )
        for key, value in tensors.items(include_nested=True, leaves_only=True)
    }


CLIENTS: dict[str, Callable[[np.ndarray], Episode]] = {
    "vla-eval": vla_eval,
    "lerobot": lerobot,
    "torchrl": torchrl,
}

if __name__ == "__main__":
    client, actions, out = sys.argv[1:]
    episode = CLIENTS[client](np.load(actions))
    with open(out, "wb") as file:
        pickle.dump(episode, file)
