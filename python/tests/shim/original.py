"""Runs a script of this folder with the shim, and with the original if it is installed.

`ROLLOUT_ORIGINAL` names the Python of an environment with the original (hf-libero 0.1.4, robosuite
1.4.0, MuJoCo 3.3.7) and its assets."""

import os
import pickle
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).resolve().parent
#: Longest duration of a script, minutes.
MINUTES = 20


def original_python() -> str:
    """Returns the original's Python, or skips the test."""
    python = os.environ.get("ROLLOUT_ORIGINAL")
    if not python or not Path(python).exists():
        pytest.skip("the original is not installed: ROLLOUT_ORIGINAL names no Python")
    return python


def run(python: str, script: str, *arguments: str, **variables: str) -> Any:
    """Runs a script, and returns the object that the script pickled into the file named by its last
    argument."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.pickle"
        done = subprocess.run(
            [python, str(HERE / script), *arguments, str(out)],
            env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1", **variables},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=MINUTES * 60,
        )
        assert done.returncode == 0, f"{script} {arguments} with {python}:\n{done.stderr[-4000:]}"
        return pickle.loads(out.read_bytes())


def run_original(script: str, *arguments: str, **variables: str) -> Any:
    """Runs a script with the original, which renders with OpenGL without a display."""
    python = original_python()
    root = Path(packages(python)) / "libero" / "libero"
    # Without a configuration file, the original asks for its folders on standard input.
    with tempfile.TemporaryDirectory() as settings:
        folders = {
            "benchmark_root": root,
            "bddl_files": root / "bddl_files",
            "init_states": root / "init_files",
            "datasets": root.parent / "datasets",
            "assets": root / "assets",
        }
        Path(settings, "config.yaml").write_text(
            "".join(f"{key}: {folder}\n" for key, folder in folders.items())
        )
        variables = {"LIBERO_CONFIG_PATH": settings, "MUJOCO_GL": "egl", **variables}
        # The original's Python must not find the shim.
        return run(python, script, *arguments, PYTHONPATH="", **variables)


def packages(python: str) -> str:
    """Returns the folder of an environment's packages."""
    return printed_by(python, "import site; print(site.getsitepackages()[0])")


def printed_by(python: str, code: str) -> str:
    done = subprocess.run([python, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()
