"""The command `libero-download-assets`, as LIBERO's installations call it."""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence


def command(arguments: Sequence[str] | None = None) -> list[str]:
    """Returns the arguments for `python -m rollout_libero`."""
    parser = argparse.ArgumentParser(
        prog="libero-download-assets",
        description="Fetches LIBERO's assets; `python -m rollout_libero fetch` has more options.",
    )
    parser.add_argument(
        "--skip-existing",
        action="store_true",
        help="accepted without effect: complete files are never fetched again",
    )
    parser.parse_args(arguments)
    return ["fetch"]


def main() -> int:
    """Fetches the assets and returns the exit status."""
    module = [sys.executable, "-m", "rollout_libero"]
    return subprocess.run([*module, *command()]).returncode
