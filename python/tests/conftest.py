"""Setup for all tests of the Python packages."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

# A shell that starts the tests in the background makes Python ignore Ctrl-C, which some tests send.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def programs() -> Path:
    """The folder of the programs coordinator, worker and policy-gateway."""
    folder = os.environ.get("ROLLOUT_PROGRAMS")
    if not folder:
        pytest.skip("ROLLOUT_PROGRAMS names no folder with the programs")
    return Path(folder)


@pytest.fixture(scope="session")
def python() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs Python in a process with these arguments, and environment variables besides its own."""

    def run(*arguments: object, **variables: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, *map(str, arguments)]
        environment = {**os.environ, **variables}
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600)

    return run
