"""Two evaluation loops that others use, with a policy of random weights, for `cost.py`.

`lerobot` is `rollout` of LeRobot's `lerobot_eval`, called as it is, over its vector environment.
`openpi` has the steps of openpi's `examples/libero/main.py` in the same order: one environment, one
query after another through openpi's client. `serve` is its server. They run the original LIBERO,
task 0 of each suite, for `--secs` seconds of control steps or a whole rollout. Neither loop makes
its videos.

Needs lerobot, hf-libero, robosuite 1.4.0, openpi-client and websockets.
"""

import argparse
import asyncio
import collections
import os
import time
from pathlib import Path

import numpy as np
import torch
from random_policy import SIZES, WIDTH, Meter, RandomPolicy
from torch import Tensor, nn

#: Control steps of a rollout that does not succeed.
SUITES = {"libero_object": 280, "libero_10": 520}


class Over(Exception):
    """The time of a suite is over."""


class Clock:
    """The window of a suite: opened after the reset, and ended by an exception."""

    def __init__(self, suite: str, secs: float, meter: Meter) -> None:
        self.suite, self.secs, self.meter = suite, secs, meter

    def open(self, fixed_secs: float) -> None:
        """Begins the window. `fixed_secs` is a rollout's share of set-up and reset.

        cost.py adds it to the time of the rollout's steps.
        """
        self.meter.counts |= {"suite": self.suite, "fixed_secs": fixed_secs}
        self.meter.add(steps=0)
        self.ends = time.monotonic() + self.secs

    def step(self, count: int) -> None:
        self.meter.add(steps=count)
        if time.monotonic() > self.ends:
            raise Over


class Chunks(nn.Module):
    """The policy as LeRobot's: a chunk's actions are executed before the next query."""

    def __init__(self, policy: RandomPolicy) -> None:
        super().__init__()
        self.policy = policy
        self.random = np.random.default_rng(0)

    def reset(self) -> None:
        self.left: list[np.ndarray] = []

    def to_device(self, batch: dict) -> dict:
        device = self.policy.device
        return {k: v.to(device) if isinstance(v, Tensor) else v for k, v in batch.items()}

    def select_action(self, batch: dict) -> Tensor:
        if not self.left:
            images = [batch["observation.images.image"], batch["observation.images.image2"]]
            frames = (torch.stack(images, 1) * 255).round().to(torch.uint8)
            shape = (len(frames), self.policy.size.chunk, WIDTH)
            chunks = self.policy.answer(
                frames.permute(0, 1, 3, 4, 2),
                np.stack([self.policy.words(task) for task in batch["task"]]),
                batch["observation.state"].cpu().numpy(),
                self.random.standard_normal(shape, np.float32),
            )
            self.left = list(chunks[:, : self.policy.size.execute].transpose(1, 0, 2))
        return torch.from_numpy(self.left.pop(0))


def run_lerobot(suite: str, clock: Clock, policy: Chunks, arguments: argparse.Namespace) -> None:
    from lerobot.envs import close_envs, make_env, make_env_pre_post_processors
    from lerobot.envs.configs import LiberoEnv
    from lerobot.scripts.lerobot_eval import rollout

    count = arguments.envs
    began = time.monotonic()
    config = LiberoEnv(task=suite, task_ids=[0], observation_height=256, observation_width=256)
    envs = make_env(config, n_envs=count, use_async_envs=True)
    calls = []

    def after_step(_) -> None:
        calls.append(time.monotonic())
        if len(calls) == 1:  # after the reset
            clock.open((calls[0] - began) / count)
        else:
            clock.step(count)

    try:
        rollout(
            envs[suite][0],
            policy,
            *make_env_pre_post_processors(config, None),
            policy.to_device,
            torch.nn.Identity(),
            seeds=list(range(count)),
            render_callback=after_step,
        )
    finally:
        close_envs(envs)


def run_openpi(suite: str, clock: Clock, client, arguments: argparse.Namespace) -> None:
    from openpi_client import image_tools
    from robosuite.utils.transform_utils import quat2axisangle

    from libero.libero import benchmark, get_libero_path
    from libero.libero.envs import OffScreenRenderEnv

    began = time.monotonic()
    task = benchmark.get_benchmark_dict()[suite]().get_task(0)
    bddl, states = (
        os.path.join(get_libero_path(kind), task.problem_folder, name)
        for kind, name in (("bddl_files", task.bddl_file), ("init_states", task.init_states_file))
    )
    env = OffScreenRenderEnv(bddl_file_name=bddl, camera_heights=256, camera_widths=256)
    env.seed(7)
    made = time.monotonic()
    env.reset()
    seen = env.set_init_state(torch.load(states, weights_only=False)[0])
    for _ in range(10):
        seen, *_ = env.step([0.0] * 6 + [-1.0])
    # One environment serves the ten rollouts of a task, and is reset before each.
    clock.open((made - began) / 10 + time.monotonic() - made)
    plan: collections.deque = collections.deque()
    try:
        for _ in range(SUITES[suite]):
            frames = []
            for camera in ("agentview", "robot0_eye_in_hand"):
                turned = np.ascontiguousarray(seen[f"{camera}_image"][::-1, ::-1])
                resized = image_tools.resize_with_pad(turned, 224, 224)
                frames.append(image_tools.convert_to_uint8(resized))
            if not plan:
                rotation = quat2axisangle(seen["robot0_eef_quat"])
                state = (seen["robot0_eef_pos"], rotation, seen["robot0_gripper_qpos"])
                query = {"observation/image": frames[0], "observation/wrist_image": frames[1]}
                query |= {"observation/state": np.concatenate(state), "prompt": task.language}
                plan.extend(client.infer(query)["actions"][: arguments.execute])
            seen, *_ = env.step(plan.popleft().tolist())
            clock.step(1)
    finally:
        env.close()


async def serve(policy: RandomPolicy) -> None:
    """Serves as openpi's WebsocketPolicyServer: one query at a time, in the event loop."""
    from openpi_client import msgpack_numpy
    from websockets.asyncio.server import serve

    random = np.random.default_rng(0)

    async def handle(socket) -> None:
        await socket.send(msgpack_numpy.packb({}))
        async for message in socket:
            seen = msgpack_numpy.unpackb(message)
            frames = [seen["observation/image"], seen["observation/wrist_image"]]
            actions = policy.answer(
                torch.from_numpy(np.stack(frames))[None],
                policy.words(seen["prompt"])[None],
                seen["observation/state"][None],
                random.standard_normal((1, policy.size.chunk, WIDTH), np.float32),
            )
            await socket.send(msgpack_numpy.packb({"actions": actions[0]}))

    async with serve(handle, "127.0.0.1", 0, compression=None, max_size=None) as server:
        print(f"listening on 127.0.0.1:{server.sockets[0].getsockname()[1]}", flush=True)
        await server.serve_forever()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("loop", choices=["lerobot", "openpi", "serve"])
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--size", choices=SIZES)
    parser.add_argument("--envs", type=int, default=10, help="environments of lerobot")
    parser.add_argument("--connect", help="address of the server for openpi")
    parser.add_argument("--execute", type=int, help="executed actions of an answer to openpi")
    parser.add_argument("--secs", type=float, help="control steps of each suite last so long")
    parser.add_argument("--meter", type=Path, help="file of what it has done")
    arguments = parser.parse_args()
    meter = Meter(arguments.meter)
    if arguments.loop == "serve":
        policy = RandomPolicy(arguments.device, arguments.size, (1,), side=224, meter=meter)
        return asyncio.run(serve(policy))
    if arguments.loop == "lerobot":
        batches = (arguments.envs,)
        policy = Chunks(RandomPolicy(arguments.device, arguments.size, batches, meter=meter))
        run = run_lerobot
    else:
        from openpi_client.websocket_client_policy import WebsocketClientPolicy

        host, port = arguments.connect.split(":")
        policy, run = WebsocketClientPolicy(host, int(port)), run_openpi
    for suite in SUITES:
        try:
            run(suite, Clock(suite, arguments.secs, meter), policy, arguments)
        except Over:
            pass
        meter.counts["suite"] = None
        meter.add()


if __name__ == "__main__":
    main()
