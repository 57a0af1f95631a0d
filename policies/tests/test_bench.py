"""The benchmark's policy, and the arithmetic of what a campaign costs."""

import sys
from argparse import Namespace
from pathlib import Path

import pytest
from conftest import assert_conforms

torch = pytest.importorskip("torch")

sys.path.insert(0, str(Path(__file__).parents[1] / "bench"))

import cost  # noqa: E402
from random_policy import SIZES, Network, RandomPolicy  # noqa: E402


def test_the_policy_conforms():
    assert_conforms(RandomPolicy("cpu", "tiny", batches=(4,)))


@pytest.mark.parametrize("size", ["smolvla", "pi05"])
def test_a_network_has_as_many_parameters_as_published(size):
    with torch.device("meta"):
        Network(SIZES[size])


@pytest.mark.parametrize("arm, hours", [("openpi", "29.5"), ("lerobot-async", "42.0")])
def test_the_hours_of_a_campaign_follow_from_rates_and_failures(arm, hours):
    # Of LeRobot's ten rollouts of a task nearly always one fails, and all last as long.
    window = {"fixed_secs": 2, "steps_per_sec": 10, "forward": 0.5, "cores": 1}
    windows = {"libero_object": window, "libero_10": window}
    result = {"arm": arm, "size": "tiny", "execute": 5, "windows": windows}
    result |= {"busy": 0.5, "host_gib": 1, "gpu_gib": 1}
    steps = {"libero_object": 100, "libero_10": 200}
    assumed = Namespace(envs=10, failures=0.5, success_steps=steps, rollouts=3600)
    assert cost.summary(result, assumed).split(" | ")[-1] == f"{hours} |"
