"""Where the shim's tests find what they are held against."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[4] / "shared"
ASSETS = SHARED / "libero-assets"

# Before anything imports the shim: no configuration of whoever runs the tests counts.
os.environ["LIBERO_CONFIG_PATH"] = tempfile.mkdtemp(prefix="libero-config-")
if ASSETS.is_dir():
    os.environ["ROLLOUT_ASSETS"] = str(ASSETS)
else:
    os.environ.setdefault("ROLLOUT_ASSETS", "primitives")


@pytest.fixture(scope="session")
def real_assets() -> Path:
    """LIBERO's assets, with which reference frames and contacts were recorded."""
    if not ASSETS.is_dir():
        pytest.skip(f"LIBERO's assets are not at {ASSETS}")
    return ASSETS


@pytest.fixture
def bddl_file() -> str:
    """The file of a task with few objects."""
    from libero.libero import benchmark

    return benchmark.get_benchmark_dict()["libero_goal"]().get_task_bddl_file_path(8)
