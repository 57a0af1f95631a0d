"""A server with openpi's interface behind the gateway receives the inputs that openpi's own LIBERO
client would send.

Runs the program that the environment variable POLICY_GATEWAY names."""

import contextlib
import hashlib
import json
import subprocess
import sys
from pathlib import Path

import grpc
import numpy as np
import pytest
from conftest import client_behind, refusal, serving_at

from rollout_policies.proto import policy_pb2 as pb

pytest.importorskip("openpi_client", reason="openpi-client is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")
from openpi_client import image_tools  # noqa: E402

SERVER = Path(__file__).parent / "simulated_openpi_server.py"
KEY = "key-of-the-simulated-server"


def simulated(received, *arguments):
    return serving_at([sys.executable, str(SERVER), "--received", str(received), *arguments])


def observation(side=256):
    frames = np.random.default_rng(3).integers(0, 256, (2, side, side, 3), dtype=np.uint8)
    names = ("agentview", "robot0_eye_in_hand")
    images = [
        pb.Image(camera=name, width=side, height=side, rgb=frame.tobytes())
        for name, frame in zip(names, frames)
    ]
    readings = {
        pb.STATE_FIELD_EEF_POS: (0.1, 0.2, 0.3),
        pb.STATE_FIELD_EEF_AXIS_ANGLE: (3.1, 0.0, -0.2),
        pb.STATE_FIELD_GRIPPER_POS: (0.04, -0.04),
    }
    state = [pb.StateReading(field=field, values=values) for field, values in readings.items()]
    return frames, pb.Observation(images=images, state=state)


def test_the_server_gets_the_inputs_of_openpis_own_client(program, received):
    frames, message = observation()
    with (
        simulated(received) as server,
        client_behind(program, "--route", f"x=ws://{server}") as client,
    ):
        described = client.describe()
        assert (described.name, described.horizon, described.execute) == ("openpi", 5, 5)
        assert described.stochastic and described.unseeded
        client.reset(suite="libero_goal", instruction="open the drawer, please")
        first = client.infer(query_index=0, observation=message)
        again = client.infer(query_index=0, observation=message)
        other = client.infer(query_index=1, observation=message)
    assert first.shape == (5, 7)
    assert (first == again).all(), "a retry is answered from the gateway's memory"
    assert (first != other).any()
    lines = [json.loads(line) for line in received.read_text().splitlines()]
    assert len(lines) == 2
    expected = [
        image_tools.convert_to_uint8(
            image_tools.resize_with_pad(np.ascontiguousarray(frame[::-1, ::-1]), 224, 224)
        )
        for frame in frames
    ]
    assert lines[0] == {
        "keys": ["observation/image", "observation/state", "observation/wrist_image", "prompt"],
        "images": [["uint8", 224, 224, 3]] * 2,
        "digests": [hashlib.sha256(frame.tobytes()).hexdigest() for frame in expected],
        "state": ["float64", 0.1, 0.2, 0.3, 3.1, 0.0, -0.2, 0.04, -0.04],
        "prompt": "open the drawer, please",
    }


def test_the_server_passes_the_conformance_check_except_for_seeds(program, received):
    with simulated(received) as server:
        check = subprocess.run(
            [program, "check", f"ws://{server}?execute=10", "--suite", "libero_goal"],
            capture_output=True,
            text=True,
        )
    assert check.returncode == 0, check.stdout + check.stderr
    assert "skip  the same seed gives the same actions: the policy's random numbers" in check.stdout
    assert "pass  a retry gets the same actions" in check.stdout
    prompts = [json.loads(line)["prompt"] for line in received.read_text().splitlines()]
    # The search for mistakes also sends sentences of other tasks.
    assert prompts[0] == "open the middle drawer of the cabinet"
    assert "put the cream cheese in the bowl" in prompts


def test_the_check_finds_the_keys_that_a_server_misses_and_names_its_address(program, received):
    keys = "image,wrist_image_left,proprio,task_instruction"
    with simulated(received, "--keys", keys) as server:
        command = [program, "check", f"ws://{server}?execute=10&state=joints&size=128&rotate=0"]
        check = subprocess.run(command, capture_output=True, text=True)
    assert check.returncode == 0, check.stdout + check.stderr
    found = "image_key=image&wrist_key=wrist_image_left&state_key=proprio"
    found += "&prompt_key=task_instruction&rotate=0&size=128&state=joints"
    assert f"write ws://{server}?execute=10&{found} as its route" in check.stdout
    line = json.loads(received.read_text().splitlines()[0])
    assert line["keys"] == sorted(keys.split(","))
    assert line["images"] == [["uint8", 128, 128, 3]] * 2 and len(line["state"]) == 1 + 9


def test_the_check_of_a_server_that_is_not_there_names_the_address_as_given(program):
    command = [program, "check", "ws://127.0.0.1:1?execute=10"]
    check = subprocess.run(command, capture_output=True, text=True)
    assert check.returncode == 1 and "grpc://127" not in check.stderr, check.stderr
    assert "ws://127.0.0.1:1?execute=10" in check.stderr


def test_a_replaced_server_is_recorded_as_another_connection(program, received):
    def described(client):
        described = client.describe()
        settings = {setting.name: setting.value for setting in described.settings}
        return described.checkpoint, settings.pop("connected since"), settings

    with contextlib.ExitStack() as stack:
        with simulated(received) as server:
            route = f"x=ws://{server}?checkpoint=step-7"
            client = stack.enter_context(client_behind(program, "--route", route))
            first = described(client)
            assert first == described(client) and first[0] == "step-7, as its route names it"
        with simulated(received, "--port", server.rsplit(":", 1)[1]):
            second = described(client)
    assert first[1] != second[1]
    assert (first[0], first[2]) == (second[0], second[2])


def test_the_policys_exception_reaches_the_worker_and_the_next_query_is_answered(program, received):
    _, message = observation()
    with (
        simulated(received) as server,
        client_behind(program, "--route", f"x=ws://{server}") as client,
    ):
        client.reset(instruction="raise")
        code, text = refusal(client.infer, observation=message)
        assert code == grpc.StatusCode.INTERNAL and "does not like this prompt" in text
        client.reset(instruction="reach")
        assert client.infer(observation=message).shape == (5, 7)


def test_the_key_in_the_token_file_is_sent_to_the_server(program, received, tmp_path):
    _, message = observation()
    config = tmp_path / "gateway.toml"
    key = tmp_path / "key"
    with simulated(received, "--api-key", KEY) as server:
        config.write_text(f'[policy.x]\nreplicas = ["ws://{server}"]\ntoken_file = "{key}"\n')
        key.touch(mode=0o600)
        key.write_text("worker another-key-than-that\n")
        with client_behind(program, "--config", str(config)) as client:
            code, text = refusal(client.reset, instruction="reach")
        assert code == grpc.StatusCode.UNAVAILABLE and "401" in text and "`token_file`" in text
        key.write_text(f"worker {KEY}\n")
        with client_behind(program, "--config", str(config)) as client:
            client.reset(instruction="reach")
            assert client.infer(observation=message).shape == (5, 7)
