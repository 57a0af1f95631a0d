"""Measures the answers per second of a GPU policy: alone, served, and behind the gateway.

Writes one JSON object. The policy is served by this package's Python server. Slots are those of
`bench_gateway slots`: each has its own connection and sends its next query immediately after an
answer.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import torch
from random_policy import BATCHES, CAMERAS, SIZES, STATE, RandomPolicy

from rollout_policies import Episode, Observation

HERE = Path(__file__).parent
#: Time limit for a server to end after SIGTERM, s.
END_SECS = 300


def observations(policy: RandomPolicy, count: int) -> list[Observation]:
    """Returns synthetic observations, each of a separate episode."""
    result = []
    for seed in range(count):
        episode = Episode(f"s{seed}", "libero_object", "pick up the butter", seed)
        policy.reset(episode)
        frames = np.random.default_rng(seed).integers(0, 256, (2, 256, 256, 3), dtype=np.uint8)
        images = {camera.name: frame for camera, frame in zip(CAMERAS, frames)}
        state = {field: np.zeros(field.size) for field in STATE}
        result.append(Observation(episode, 0, images, state))
    return result


def measure_network(policy: RandomPolicy, batch: int, secs: float) -> dict:
    """Measures the network alone, in this process, batch after batch."""
    batch_observations = observations(policy, batch)
    for _ in range(3):
        policy.infer_batch(batch_observations)
    took = []
    ends = time.perf_counter() + secs
    while time.perf_counter() < ends:
        began = time.perf_counter()
        # infer_batch copies the answers to the CPU, so it returns after the batch is complete.
        policy.infer_batch(batch_observations)
        took.append(time.perf_counter() - began)
    milliseconds = 1e3 * np.array(took)
    return {
        "batch": batch,
        "observations_per_sec": batch * len(took) / sum(took),
        "batch_millis": {
            "p50": float(np.percentile(milliseconds, 50)),
            "p99": float(np.percentile(milliseconds, 99)),
        },
    }


@contextlib.contextmanager
def running(command: list[str]):
    """Context of a server process; yields the address that it prints."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline().split()
        if line[:2] != ["listening", "on"]:
            raise SystemExit(f"error: failed to start {command[0]}: it printed {line}")
        yield line[2]
    finally:
        process.terminate()
        process.wait(END_SECS)


def measure_slots(programs: dict, address: str, count: int, secs: int) -> dict:
    """Runs `bench_gateway slots` against a server. Returns its JSON report."""
    command = [programs["bench"], "slots", "--address", address]
    command += ["--slots", str(count), "--secs", str(secs)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def measure_served(programs: dict, arguments: argparse.Namespace, max_batch: int) -> dict:
    """Measures the simulated policy behind the Python server, queried directly and through the
    gateway."""
    command = [sys.executable, str(HERE / "random_policy.py"), "--device", arguments.device]
    command += ["--max-batch", str(max_batch), "--size", arguments.size]
    with running(command) as server:
        route = f"random-{arguments.size}-size=grpc://{server}"
        gateway = [programs["gateway"], "--listen", "127.0.0.1:0", "--route", route]
        with running(gateway) as gateway_address:
            return {
                "max_batch": max_batch,
                "direct": [measure_slots(programs, server, n, arguments.secs) for n in (1, 64)],
                "through_gateway": [
                    measure_slots(programs, gateway_address, n, arguments.secs) for n in (1, 64)
                ],
            }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bin", type=Path, required=True, help="folder of the two programs")
    parser.add_argument("--output", type=Path, required=True, help="JSON file to write")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument(
        "--secs",
        type=int,
        default=10,
        help="seconds of each measurement of a server; the network alone is measured half as long",
    )
    parser.add_argument("--size", choices=SIZES, default="smolvla", help="tiny on a CPU")
    arguments = parser.parse_args()
    candidates = [arguments.bin / "examples" / "bench_gateway", arguments.bin / "bench_gateway"]
    programs = {
        "gateway": str(arguments.bin / "policy-gateway"),
        "bench": str(next((path for path in candidates if path.exists()), candidates[0])),
    }
    policy = RandomPolicy(arguments.device, arguments.size, BATCHES)
    model_alone = [measure_network(policy, batch, arguments.secs / 2) for batch in (1, 4, 16, 32)]
    on_gpu = policy.device.type == "cuda"
    report = {
        "policy": policy.description.name,
        "weights": "random",
        "parameters": policy.description.parameters,
        "dtype": str(policy.dtype),
        "device": torch.cuda.get_device_name() if on_gpu else platform.processor() or "CPU",
        "cores": os.cpu_count(),
        "torch": torch.__version__,
        "model_alone": model_alone,
    }
    # Frees GPU memory for the servers.
    del policy
    report["served"] = [measure_served(programs, arguments, max_batch) for max_batch in (16, 32)]
    arguments.output.write_text(json.dumps(report, indent=2) + "\n")
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
