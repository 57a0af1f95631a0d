"""`python -m rollout_client export lerobot ARCHIVE --output DIR`."""

from __future__ import annotations

import argparse
import sys

from . import lerobot
from .archive import Archive
from .errors import CoordinatorError


def main(arguments: list[str] | None = None) -> int:
    """Runs a command; returns its exit code."""
    flags = _parser().parse_args(arguments)
    try:
        with Archive(flags.archive) as archive:
            count = lerobot.export(archive, flags.output, films=flags.films)
            print(f"wrote {count} episodes of campaign {archive.name} to {flags.output}")
    except CoordinatorError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m rollout_client")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    export = commands.add_parser("export", help="write a campaign for another tool")
    forms = export.add_subparsers(dest="form", required=True, metavar="FORM")
    command = forms.add_parser(
        "lerobot",
        help="a LeRobot dataset (format v2.1) of the rollouts that recorded their actions",
    )
    command.add_argument("archive", help="file written by `coordinator campaign archive`")
    command.add_argument("--output", required=True, metavar="DIR", help="folder to write")
    command.add_argument("--films", action="store_true", help="export filmed rollouts only")
    return parser


if __name__ == "__main__":
    sys.exit(main())
