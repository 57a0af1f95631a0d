"""The gateway's commands `check` and `compare` find faults of servers made with this package.

Runs the program that the environment variable POLICY_GATEWAY names."""

import json
import subprocess

import numpy as np
import pytest
from conftest import Plain, gateway_program

from rollout_policies import Camera, Description, State, start
from rollout_policies.examples.colour_servo import ColourServo

CAMERAS = (Camera("agentview", 128, 128), Camera("robot0_eye_in_hand", 128, 128))


class PositionSensitive(Plain):
    """Its answers depend on the content of each part of a frame, the state and the instruction."""

    description = Description(
        name="position-sensitive",
        horizon=4,
        cameras=CAMERAS,
        state=(State.EEF_POS, State.EEF_AXIS_ANGLE, State.GRIPPER_POS),
    )

    def frames(self, observation):
        return [observation.upright(camera.name) for camera in CAMERAS]

    def infer(self, observation):
        weights = np.random.default_rng(7)
        features = np.zeros(7)
        for frame in self.frames(observation):
            coarse = frame[4::8, 4::8].astype(float).ravel() / 255 - 0.5
            features += weights.normal(0, 0.1, (7, coarse.size)) @ coarse
        features += weights.normal(0, 0.5, (7, 8)) @ observation.vector()
        features += 0.2 * np.sin(sum(observation.episode.instruction.encode()) + np.arange(7))
        return 0.8 * np.sin(features + 0.2 * np.arange(4)[:, None])


class Flipped(PositionSensitive):
    """Uses its frames as they arrive, bottom row first, instead of upright."""

    def frames(self, observation):
        return [observation.images[camera.name] for camera in CAMERAS]


@pytest.fixture
def run_command():
    """Runs a command on servers of given policies: `run_command("check", policy) -> JSON`."""
    program = gateway_program()
    servers = []

    def run(command, *policies):
        servers.extend(start(policy) for policy in policies)
        urls = [f"grpc://{server.address}" for server in servers[-len(policies) :]]
        finished = subprocess.run(
            [program, command, *urls, "--json"], capture_output=True, text=True
        )
        assert finished.returncode in (0, 1) and finished.stdout, finished.stderr
        judgement = json.loads(finished.stdout)
        verdict = judgement["is_same" if command == "compare" else "conforms"]
        assert verdict == (finished.returncode == 0)
        return judgement

    yield run
    for server in servers:
        server.stop(0)


def failed(examination):
    return {
        finding["point"]: finding["text"]
        for finding in examination["findings"]
        if finding["verdict"] in ("fail", "warn")
    }


@pytest.mark.parametrize("policy", [PositionSensitive, ColourServo])
def test_a_correct_server_has_no_findings(run_command, policy):
    assert failed(run_command("check", policy())) == {}
    assert run_command("compare", policy(), policy())["differences"] == []


def test_frames_that_are_not_turned_are_found(run_command):
    (difference,) = run_command("compare", PositionSensitive(), Flipped())["differences"]
    assert difference["kind"] == "frame_orientation"
    assert "flipped vertically" in difference["text"]
