"""The gateway's commands `compare` and `doctor` find faults of servers made with this package.

Runs the program that the environment variable POLICY_GATEWAY names."""

import json
import os
import subprocess

import numpy as np
import pytest

from rollout_policies import Camera, Description, Policy, State, start
from rollout_policies.examples.colour_servo import ColourServo

CAMERAS = (Camera("agentview", 128, 128), Camera("robot0_eye_in_hand", 128, 128))


class PositionSensitive(Policy):
    """Its answers depend on the content of each part of a frame, the state and the instruction."""

    description = Description(
        name="position-sensitive",
        horizon=4,
        cameras=CAMERAS,
        state=(State.EEF_POS, State.EEF_AXIS_ANGLE, State.GRIPPER_POS),
    )

    def reset(self, episode):
        pass

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


class Leaking(PositionSensitive):
    """Keeps the frames of all episodes, and so uses more and more memory."""

    def __init__(self):
        self.copies = []

    def infer(self, observation):
        for frame in self.frames(observation):
            self.copies.append(np.repeat(frame, 8, axis=0))
        return super().infer(observation)


@pytest.fixture
def run_command():
    """Runs a command on servers of given policies: `run_command("doctor", policy) -> JSON`."""
    program = os.environ.get("POLICY_GATEWAY")
    if program is None:
        pytest.skip("POLICY_GATEWAY does not name the policy-gateway program")
    servers = []

    def run(command, *policies):
        servers.extend(start(policy) for policy in policies)
        urls = [f"grpc://{server.address}" for server in servers[-len(policies) :]]
        finished = subprocess.run(
            [program, command, *urls, "--json"], capture_output=True, text=True, check=False
        )
        assert finished.returncode in (0, 1) and finished.stdout, finished.stderr
        judgement = json.loads(finished.stdout)
        verdict = judgement["is_same" if command == "compare" else "is_sound"]
        assert verdict == (finished.returncode == 0)
        return judgement

    yield run
    for server in servers:
        server.stop(0)


def failed(examination):
    return {
        finding["point"]: finding["text"]
        for finding in examination["findings"]
        if finding["verdict"] == "fail"
    }


@pytest.mark.parametrize("policy", [PositionSensitive, ColourServo])
def test_a_correct_server_has_no_findings(run_command, policy):
    assert failed(run_command("doctor", policy())) == {}
    assert run_command("compare", policy(), policy())["differences"] == []


def test_frames_that_are_not_turned_are_found(run_command):
    (difference,) = run_command("compare", PositionSensitive(), Flipped())["differences"]
    assert difference["kind"] == "frame_orientation"
    assert "flipped vertically" in difference["text"]


def test_a_server_that_keeps_every_episode_is_found_by_its_memory(run_command):
    failures = failed(run_command("doctor", Leaking()))
    assert list(failures) == ["memory"]
    assert f"process {os.getpid()} grew" in failures["memory"]
