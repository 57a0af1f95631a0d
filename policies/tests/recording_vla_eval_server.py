"""A model server of the real vla-eval, around a policy whose answers depend on the instruction. It
records the messages that it receives in a file, one JSON object per message."""

import argparse
import functools
import hashlib
import itertools
import json
import threading

import anyio
import msgpack
import numpy as np
from vla_eval.model_servers import serve
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.specs import DimSpec

GRIPPERS = (0.3, -0.2, 0.0, -1.5)


def scripted_action(step):
    """Returns the action of a step. Its gripper value, one of GRIPPERS, is neither -1 nor 1."""
    action = np.linspace(-1.2, 0.6, 7) + 0.01 * step
    action[6] = GRIPPERS[step % len(GRIPPERS)]
    return action


class Policy(PredictModelServer):
    def __init__(self, arguments):
        super().__init__(chunk_size=arguments.chunk_size)
        self.params = json.loads(arguments.params)
        self.gripper = arguments.gripper

    def get_observation_params(self):
        return self.params

    def get_action_spec(self):
        if self.gripper is None:
            return super().get_action_spec()
        return {"gripper": DimSpec("gripper", 1, self.gripper)}

    def get_observation_spec(self):
        return {}

    async def on_episode_start(self, config, ctx):
        if config["task"]["name"] == "refuse to start":
            raise KeyError("no such task")
        await super().on_episode_start(config, ctx)

    def predict(self, obs, ctx):
        match obs["task_description"]:
            case "raise":
                raise ValueError("the policy does not like this instruction")
            case "answer nothing":
                return {"thoughts": "none"}
            case "answer a cube":
                return {"actions": np.zeros((2, 3, 7))}
            case "answer a list":
                return {"action": [0.5, 0, 0, 0, 0, 0, -0.1]}
            case "answer a chunk":
                return {"actions": np.stack([scripted_action(ctx.step + at) for at in range(6)])}
            case _:
                return {"actions": scripted_action(ctx.step)}


def to_json(value):
    """Converts a received value to one that JSON can hold."""
    if isinstance(value, dict):
        return {key: to_json(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray) and value.dtype == np.uint8:
        digest = hashlib.sha256(value.tobytes()).hexdigest()
        return [value.dtype.str, *value.shape, digest, value.mean(axis=(0, 1)).tolist()]
    if isinstance(value, np.ndarray):
        return [value.dtype.str, *value.shape, *value.tolist()]
    return value


def image_encodings(data):
    """Returns the encoding of each frame of a packed message, by camera."""
    images = msgpack.unpackb(data)["payload"].get("images", {})
    return {name: image.get("format", image.get("dtype")) for name, image in images.items()}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--received", required=True, help="file to append to")
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--chunk-size", type=int)
    parser.add_argument("--params", default="{}", help="observation parameters, JSON")
    parser.add_argument("--gripper", help="format of the gripper in its action spec")
    arguments = parser.parse_args()
    received = open(arguments.received, "a", encoding="utf-8")  # Open until the process ends.
    lock = threading.Lock()
    unpack = serve.unpack_message

    def unpack_and_record(data):
        message = unpack(data)
        line = {
            "type": message.type.value,
            "seq": message.seq,
            "timestamp": type(message.timestamp).__name__,
            "payload": to_json(message.payload),
            "forms": image_encodings(data),
        }
        with lock:
            print(json.dumps(line), file=received, flush=True)
        return message

    serve.unpack_message = unpack_and_record
    handle, connections = serve._handle_connection, itertools.count()

    async def handle_and_record_end(socket, policy):
        connection = next(connections)
        await handle(socket, policy)
        with lock:
            print(
                json.dumps({"type": "disconnected", "connection": connection}),
                file=received,
                flush=True,
            )

    serve._handle_connection = handle_and_record_end

    async def run():
        async with anyio.create_task_group() as tasks:
            serving = functools.partial(
                serve.serve_async, Policy(arguments), "127.0.0.1", arguments.port
            )
            port = await tasks.start(serving)
            print(f"listening on 127.0.0.1:{port}", flush=True)

    anyio.run(run)


if __name__ == "__main__":
    main()
