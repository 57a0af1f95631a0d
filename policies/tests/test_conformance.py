"""Servers made with this package pass the gateway's conformance check.

Runs the program that the environment variable POLICY_GATEWAY names.
"""

import os
import subprocess

import numpy as np
import pytest
from conftest import Noisy

from rollout_policies import Camera, Description, Policy, State, start
from rollout_policies.examples.colour_servo import ColourServo


class Batched(Noisy):
    description = Description(name="batched", horizon=4, stochastic=True, max_batch=4)


class Remembering(Policy):
    """Wants everything there is, and keeps a number per episode."""

    description = Description(
        name="remembering",
        cameras=(Camera("agentview"), Camera("robot0_eye_in_hand")),
        state=tuple(State),
        stateful=True,
    )

    def reset(self, episode):
        episode.memory = 0.0

    def infer(self, observation):
        pixels = observation.images["agentview"].mean() / 255
        observation.episode.memory = (observation.episode.memory + pixels) / 2
        return np.full(7, observation.episode.memory)


@pytest.mark.parametrize("policy", [Noisy(), Batched(), Remembering(), ColourServo()])
def test_a_server_of_this_package_conforms(policy):
    program = os.environ.get("POLICY_GATEWAY")
    if program is None:
        pytest.skip("POLICY_GATEWAY does not name the policy-gateway program")
    server = start(policy)
    try:
        check = subprocess.run(
            [program, "check", f"grpc://{server.address}"],
            capture_output=True,
            text=True,
            check=False,
        )
    finally:
        server.stop(0)
    print(check.stdout)
    assert check.returncode == 0, check.stdout + check.stderr
