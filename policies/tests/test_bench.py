"""Conformance of the benchmark's policy, in its tiny size."""

import sys
from pathlib import Path

import pytest
from conftest import assert_conforms

torch = pytest.importorskip("torch")

sys.path.insert(0, str(Path(__file__).parents[1] / "bench"))

from simulated_smolvla import SimulatedSmolvla  # noqa: E402


def test_the_simulated_smolvla_conforms():
    assert_conforms(SimulatedSmolvla("cpu", max_batch=4, tiny=True))
