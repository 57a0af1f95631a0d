"""The generated files in every package match the .proto files."""

import pathlib
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version

import pytest

SCRIPT = pathlib.Path(__file__).resolve().parents[2] / "proto" / "regenerate.py"


def test_the_generated_files_are_current():
    try:
        version("grpcio-tools")
    except PackageNotFoundError:
        pytest.skip("grpcio-tools is not installed: pip install -e './policies[dev]'")
    check = subprocess.run([sys.executable, SCRIPT, "--check"], capture_output=True, text=True)
    assert check.returncode == 0, check.stderr
