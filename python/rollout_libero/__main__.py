"""``python -m rollout_libero fetch``: fetches what scenes are made of."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from rollout_libero import files
from rollout_libero._library import native

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


def main() -> int:
    """Does what the command line says; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m rollout_libero")
    commands = parser.add_subparsers(dest="command", required=True)
    words = "Fetches task files, robot models and LIBERO's assets; goes on where it was interrupted."
    fetch = commands.add_parser("fetch", help=words, description=words)
    fetch.add_argument(
        "--into",
        type=Path,
        metavar="DIR",
        help="where the assets go [default: packs/libero in the folder of the task files]",
    )
    fetch.add_argument(
        "--hub",
        metavar="URL",
        default=os.environ.get("HF_ENDPOINT") or None,
        help="the hub that has the assets, or a mirror of it [default: $HF_ENDPOINT, else the "
        "hub they are published on]",
    )
    given = parser.parse_args()
    try:
        _fetch(given.into, given.hub)
    except KeyboardInterrupt:
        print("interrupted; the same command goes on from here", file=sys.stderr)
        return INTERRUPTED
    except (FileNotFoundError, ValueError) as error:
        print(f"failed to {error}", file=sys.stderr)
        return 1
    return 0


def _fetch(into: Path | None, hub: str | None) -> None:
    print(f"task files and robot models: {files.sources()}", flush=True)
    folder = into or files.fetched_assets_folder()
    if (folder / "scenes").is_dir():
        print(f"LIBERO's assets: {folder} (already there; move it away to fetch it again)")
    else:
        print(f"fetching LIBERO's assets into {folder}", flush=True)
        native.fetch_assets(folder, hub)
        print(f"LIBERO's assets: {folder}")
    if into:
        print(f"to use them, give assets={str(folder.absolute())!r}, or set ROLLOUT_ASSETS")


if __name__ == "__main__":
    sys.exit(main())
