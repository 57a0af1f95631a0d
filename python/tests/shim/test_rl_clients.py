"""Unmodified files of RLinf on the shim, in RLinf's own processes and in one process (kinds that end
in `_together`). RLinf is installed with the other clients (`ROLLOUT_CLIENTS`, test_clients.py)."""

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from original import run

from libero.libero import benchmark


@pytest.fixture(scope="module")
def rlinf(clients: str) -> str:
    if subprocess.run([clients, "-c", "import rlinf"], capture_output=True).returncode:
        pytest.skip("RLinf is not among the clients")
    return clients


def roll_out(rlinf: str, shim: Path, out: Path, kind: str) -> Any:
    settings = {"PYTHONPATH": str(shim), "LIBERO_CONFIG_PATH": str(out / "settings")}
    return run(rlinf, "rl_rollouts.py", kind, **settings)


def assert_same(found: Any, expected: Any, label: str) -> None:
    if isinstance(expected, dict):
        assert list(found) == list(expected), label
        for key in expected:
            assert_same(found[key], expected[key], f"{label}/{key}")
    elif isinstance(expected, list | tuple):
        assert len(found) == len(expected), label
        for i, (one, other) in enumerate(zip(found, expected)):
            assert_same(one, other, f"{label}/{i}")
    else:
        assert type(found) is type(expected), label
        np.testing.assert_array_equal(found, expected, err_msg=label)


@pytest.mark.parametrize(
    "kind", ["rlinf", "rlinf_auto_reset", "rlinf_evaluated", "rlinf_recorded", "rlinf_plus"]
)
def test_rlinf_in_one_process_equals_rlinfs_processes(
    kind: str, rlinf: str, shim: Path, tmp_path: Path
) -> None:
    in_processes = roll_out(rlinf, shim, tmp_path, kind)
    in_one_process = roll_out(rlinf, shim, tmp_path, f"{kind}_together")
    assert in_one_process["tasks"] == in_processes["tasks"]
    # Two resets, each with an observation, and with results and a count for each of two chunks.
    assert len(in_processes["outputs"]) == 10
    assert_same(in_one_process["outputs"], in_processes["outputs"], kind)


def test_rlinf_runs_tasks_of_all_suites(rlinf: str, shim: Path, tmp_path: Path) -> None:
    rollouts = roll_out(rlinf, shim, tmp_path, "rlinf_of_130")
    instructions = {
        task.language
        for suite in benchmark.libero_suites
        for task in benchmark.task_maps[suite].values()
    }
    assert set(rollouts["tasks"]) <= instructions
    assert rollouts["outputs"][0]["main_images"].shape == (2, 64, 64, 3)
