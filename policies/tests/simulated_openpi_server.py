"""A server with the interface of openpi's WebsocketPolicyServer around a simulated policy. It sends
a metadata message first, then answers one msgpack message after another; if the policy raises, it
sends the traceback as text and closes. Messages are packed by the real openpi-client.

The policy's inputs are recorded in a file, one JSON object per query, for a test to examine."""

import argparse
import asyncio
import hashlib
import http
import json
import time
import traceback

import numpy as np
import websockets
from openpi_client import msgpack_numpy
from websockets.asyncio.server import serve


class SimulatedPolicy:
    """Answers ten actions of noise, drawn from one generator across queries."""

    def __init__(self, received, keys):
        self.noise = np.random.default_rng()
        self.received = received
        self.image_key, self.wrist_key, self.state_key, self.prompt_key = keys.split(",")

    def infer(self, observation):
        if observation[self.prompt_key] == "raise":
            raise ValueError("the policy does not like this prompt")
        images = [observation[self.image_key], observation[self.wrist_key]]
        state = observation[self.state_key]
        line = {
            "keys": sorted(observation),
            "images": [[str(image.dtype), *image.shape] for image in images],
            "digests": [hashlib.sha256(image.tobytes()).hexdigest() for image in images],
            "state": [str(state.dtype), *state.tolist()],
            "prompt": observation[self.prompt_key],
        }
        print(json.dumps(line), file=self.received, flush=True)
        actions = self.noise.uniform(-1, 1, (10, 7))
        return {"state": state, "actions": actions, "policy_timing": {"infer_ms": 1.0}}


async def handle(socket, policy, metadata):
    packer = msgpack_numpy.Packer()
    await socket.send(packer.pack(metadata))
    while True:
        try:
            observation = msgpack_numpy.unpackb(await socket.recv())
            began = time.monotonic()
            answer = policy.infer(observation)
            answer["server_timing"] = {"infer_ms": 1e3 * (time.monotonic() - began)}
            await socket.send(packer.pack(answer))
        except websockets.ConnectionClosed:
            return
        except Exception:
            await socket.send(traceback.format_exc())
            await socket.close(1011, "Internal server error.")
            return


async def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--received", required=True, help="file of received inputs")
    parser.add_argument("--port", type=int, default=0, help="0 selects a free port")
    parser.add_argument(
        "--keys",
        default="observation/image,observation/wrist_image,observation/state,prompt",
        help="keys of scene frame, wrist frame, state and instruction",
    )
    parser.add_argument("--api-key", help="key that clients must send")
    arguments = parser.parse_args()

    def admit(connection, request):
        authorization = request.headers.get("Authorization")
        if arguments.api_key and authorization != f"Api-Key {arguments.api_key}":
            return connection.respond(http.HTTPStatus.UNAUTHORIZED, "who are you?\n")
        return None

    with open(arguments.received, "w", encoding="utf-8") as received:
        policy = SimulatedPolicy(received, arguments.keys)
        served = serve(
            lambda socket: handle(socket, policy, {"simulated": True}),
            "127.0.0.1",
            arguments.port,
            compression=None,
            max_size=None,
            process_request=admit,
        )
        async with served as server:
            port = server.sockets[0].getsockname()[1]
            print(f"listening on 127.0.0.1:{port}", flush=True)
            await server.serve_forever()


asyncio.run(main())
