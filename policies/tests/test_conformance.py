"""Servers made with this package pass the gateway's conformance check.

Runs the program that the environment variable POLICY_GATEWAY names."""

import numpy as np
import pytest
from conftest import Noisy, assert_conforms

from rollout_policies import Camera, Description, Policy, State
from rollout_policies.adapters import openvla_oft, predvla, univla
from rollout_policies.catalogue import entry
from rollout_policies.examples.colour_servo import ColourServo


class Batched(Noisy):
    description = Description(name="batched", horizon=4, stochastic=True, max_batch=4)


class Remembering(Policy):
    """Requests every input, and keeps a number per episode."""

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


class ComputedOft:
    """Replaces OpenVLA-OFT's network by a function of brightness and state."""

    parameters = 0
    proprio_statistics = {"q01": [-1.0] * 8, "q99": [1.0] * 8}

    def chunk(self, scene, wrist, text, state):
        return np.full((8, 7), (scene.mean() - wrist.mean()) / 255 + state.mean() / 10)


class ComputedUnivla:
    """Replaces UniVLA's networks by a function of random numbers, brightness and the prompt."""

    parameters = 0

    def chunk(self, pixels, text, generator):
        rng = np.random.default_rng([generator, pixels.sum(), *text.encode()])
        actions, tokens = rng.uniform(-1, 1, (12, 7)), 32001 + rng.integers(0, 32, 4)
        return actions, tokens.tolist(), generator + 1


class ComputedPredvla:
    """Replaces PredVLA's network, and its correction, an episode's memory, by a running mean."""

    parameters, stride = 0, 4

    def begin(self, instruction):
        return [len(instruction) / 100]

    def step(self, correction, joints, frames):
        brightness = 0.0 if frames is None else frames[0].mean() / 255
        correction.append((correction[-1] + brightness + joints.mean() / 10) / 3)
        return np.full(7, correction[-1])


def adapters_with_computed_networks():
    """Returns adapters of the policies whose upstream packages are in no registry, with functions
    in place of the networks. They serve libero_object, the suite of the check's task."""
    served = {"suite": "libero_object", "checkpoint": "none: computed in the network's place"}
    bounds = {"q01": [-1.0] * 7, "q99": [1.0] * 7, "mask": [True] * 6 + [False]}
    return [
        openvla_oft.OpenVlaOft(entry("openvla-oft"), ComputedOft(), **served),
        univla.UniVla(entry("univla"), ComputedUnivla(), bounds, **served),
        univla.UniVla(entry("univla"), ComputedUnivla(), bounds, **served, evaluation="study"),
        predvla.PredVla(entry("predvla"), ComputedPredvla(), **served),
    ]


@pytest.mark.parametrize(
    "policy",
    [Noisy(), Batched(), Remembering(), ColourServo(), *adapters_with_computed_networks()],
    ids=lambda policy: policy.description.name,
)
def test_a_server_of_this_package_conforms(policy):
    assert_conforms(policy)
