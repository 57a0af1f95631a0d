"""Conformance of the benchmark's policy, in its tiny size."""

import sys
from pathlib import Path

import pytest
from conftest import assert_conforms

torch = pytest.importorskip("torch")

sys.path.insert(0, str(Path(__file__).parents[1] / "bench"))

from random_policy import SIZES, Network, RandomPolicy  # noqa: E402


def test_the_policy_conforms():
    assert_conforms(RandomPolicy("cpu", "tiny", batches=(4,)))


@pytest.mark.parametrize("size", ["smolvla", "pi05"])
def test_a_network_has_as_many_parameters_as_published(size):
    with torch.device("meta"):
        Network(SIZES[size])
