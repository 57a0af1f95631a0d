"""Unmodified files of RLinf on the shim, which are installed with the other clients
(`ROLLOUT_CLIENTS`, test_clients.py)."""

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


def assert_same(ours: Any, theirs: Any, label: str) -> None:
    if isinstance(theirs, dict):
        assert list(ours) == list(theirs), label
        for key in theirs:
            assert_same(ours[key], theirs[key], f"{label}/{key}")
    elif isinstance(theirs, list | tuple):
        assert len(ours) == len(theirs), label
        for i, (our, their) in enumerate(zip(ours, theirs)):
            assert_same(our, their, f"{label}/{i}")
    else:
        assert type(ours) is type(theirs), label
        np.testing.assert_array_equal(ours, theirs, err_msg=label)


@pytest.mark.parametrize(
    "kind", ["rlinf", "rlinf_auto_reset", "rlinf_evaluated", "rlinf_recorded", "rlinf_plus"]
)
def test_rlinf_in_one_process_equals_rlinfs_processes(
    kind: str, rlinf: str, shim: Path, tmp_path: Path
) -> None:
    theirs = roll_out(rlinf, shim, tmp_path, kind)
    ours = roll_out(rlinf, shim, tmp_path, f"{kind}_together")
    assert ours["tasks"] == theirs["tasks"]
    # Two resets, each with an observation, and with results and a count for each of two chunks.
    assert len(theirs["outputs"]) == 10
    assert_same(ours["outputs"], theirs["outputs"], kind)


def test_rlinf_runs_tasks_of_all_suites(rlinf: str, shim: Path, tmp_path: Path) -> None:
    rollouts = roll_out(rlinf, shim, tmp_path, "rlinf_of_130")
    instructions = {
        task.language
        for suite in benchmark.libero_suites
        for task in benchmark.task_maps[suite].values()
    }
    assert set(rollouts["tasks"]) <= instructions
    assert rollouts["outputs"][0]["main_images"].shape == (2, 64, 64, 3)
