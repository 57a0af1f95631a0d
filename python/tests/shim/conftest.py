"""Locations of the references for the shim's tests."""

import importlib
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

# The tests can import scripts and helpers of this folder, however pytest imports the tests.
sys.path.insert(0, str(Path(__file__).resolve().parent))
# This is set before any import of the shim, so that the user's own configuration is ignored.
os.environ["LIBERO_CONFIG_PATH"] = tempfile.mkdtemp(prefix="libero-config-")

pytest.importorskip("libero._absent", reason="rollout-libero-shim is not installed")

from reference import fetched_assets


@pytest.fixture(scope="module", autouse=True)
def assets() -> Iterator[None]:
    """Uses LIBERO's assets if they can be fetched, otherwise the built-in simple shapes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROLLOUT_ASSETS", "libero" if fetched_assets() else "primitives")
        yield


@pytest.fixture(scope="session")
def real_assets() -> Path:
    """LIBERO's assets, which were used to record reference frames and contacts."""
    folder = fetched_assets()
    if folder is None:
        pytest.skip("LIBERO's assets cannot be fetched")
    return folder


@pytest.fixture(scope="module")
def clients() -> str:
    """The Python of an environment with PyTorch and clients of LIBERO."""
    path = os.environ.get("ROLLOUT_CLIENTS")
    if not path or not Path(path).exists():
        pytest.skip("the clients are not installed: ROLLOUT_CLIENTS names no Python")
    return path


@pytest.fixture(scope="module")
def shim(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with only the packages under test."""
    folder = tmp_path_factory.mktemp("packages")
    for name in ("rollout_libero", "libero", "liberoplus"):
        package = importlib.import_module(name)
        (folder / name).symlink_to(Path(str(package.__file__)).parent)
    return folder


@pytest.fixture(scope="module")
def plus_files(assets: None) -> None:
    """LIBERO-Plus' task files, which are fetched at first use."""
    from liberoplus.liberoplus import get_libero_path

    try:
        get_libero_path("bddl_files")
    except FileNotFoundError as error:
        pytest.skip(f"LIBERO-Plus' task files cannot be fetched: {error}")


@pytest.fixture
def config_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of LIBERO's configuration, which does not exist yet."""
    from libero.libero import paths

    file = tmp_path / "config.yaml"
    monkeypatch.setattr(paths, "config_file", str(file))
    monkeypatch.setattr(paths, "libero_config_path", str(tmp_path))
    return file


@pytest.fixture
def bddl_file() -> str:
    """The BDDL file of a task with few objects."""
    from libero.libero import benchmark

    return benchmark.get_benchmark_dict()["libero_goal"]().get_task_bddl_file_path(8)
