"""``python -m rollout_libero fetch`` fetches the files of scenes; ``python -m rollout_libero
doctor`` reports the package ``libero`` that programs import."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rollout_libero import doctor, files

INTERRUPTED = 130
"""Exit status after Ctrl-C, by the convention of shells."""


def main() -> int:
    """Runs the command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m rollout_libero")
    commands = parser.add_subparsers(dest="command", required=True)
    summary = (
        "Fetches task files, robot models and LIBERO's assets; continues an interrupted fetch."
    )
    fetch = commands.add_parser("fetch", help=summary, description=summary)
    fetch.add_argument(
        "--tasks",
        metavar="SUITE/N,...|all",
        default="all",
        help="tasks whose assets are fetched [default: all forty]",
    )
    fetch.add_argument(
        "--everything", action="store_true", help="fetch all of LIBERO's 585 files, 236 MB"
    )
    fetch.add_argument(
        "--into",
        type=Path,
        metavar="DIR",
        help="folder for the assets [default: the folder from which scenes load them]",
    )
    origins = fetch.add_mutually_exclusive_group()
    origins.add_argument(
        "--index",
        metavar="URL",
        help="the package index, or a mirror of it [default: $ROLLOUT_INDEX_URL, or the "
        "index that pip or uv is set to use, else PyPI]",
    )
    origins.add_argument(
        "--wheels",
        type=Path,
        metavar="DIR",
        help="a folder with the wheels, for a machine without a network [default: $ROLLOUT_WHEELS]",
    )
    summary = "Reports the imported package libero, other packages of that name, and remedies."
    commands.add_parser("doctor", help=summary, description=summary)
    flags = parser.parse_args()
    if flags.command == "doctor":
        return doctor.report()
    tasks = None if flags.tasks == "all" else flags.tasks.split(",")
    try:
        print(f"task files and robot models: {files.sources()}", flush=True)
        folder = files.fetch_assets(
            tasks,
            everything=flags.everything,
            into=flags.into,
            index=flags.index,
            wheels=flags.wheels,
        )
    except KeyboardInterrupt:
        print("interrupted; the same command continues from here", file=sys.stderr)
        return INTERRUPTED
    except (FileNotFoundError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    print(f"LIBERO's assets: {folder}")
    if flags.into:
        print(f"to use them, pass assets={str(folder)!r} to environments, or set ROLLOUT_ASSETS")
    return 0


if __name__ == "__main__":
    sys.exit(main())
