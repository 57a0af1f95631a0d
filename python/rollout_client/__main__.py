"""`python -m rollout_client export lerobot|tensorboard|wandb ARCHIVE --output DIR`."""

from __future__ import annotations

import argparse
import sys

from .archive import Archive
from .errors import CoordinatorError
from .export import lerobot, tensorboard, wandb


def main(arguments: list[str] | None = None) -> int:
    """Runs a command; returns its exit code."""
    flags = _parser().parse_args(arguments)
    try:
        with Archive(flags.archive) as archive:
            if flags.form == "lerobot":
                count = lerobot.export(archive, flags.output, films=flags.films)
                unit = "episodes"
            elif flags.form == "tensorboard":
                count, unit = tensorboard.export(archive, flags.output), "points"
            else:
                count = wandb.export(archive, flags.output, project=flags.project)
                unit = "points"
            print(f"wrote {count} {unit} of campaign {archive.name} to {flags.output}")
    except CoordinatorError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m rollout_client")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    export = commands.add_parser("export", help="write a campaign for another tool")
    forms = export.add_subparsers(dest="form", required=True, metavar="FORM")
    for form, about in (
        ("lerobot", "a LeRobot dataset (format v2.1) of the rollouts that recorded their actions"),
        ("tensorboard", "success rates over time"),
        ("wandb", "success rates over time and a table of all results, for `wandb sync`"),
    ):
        command = forms.add_parser(form, help=about)
        command.add_argument("archive", help="file written by `coordinator campaign archive`")
        command.add_argument("--output", required=True, metavar="DIR", help="folder to write")
        if form == "lerobot":
            command.add_argument("--films", action="store_true", help="export filmed rollouts only")
        if form == "wandb":
            command.add_argument(
                "--project", default="rollout", help="project of the run (default: rollout)"
            )
    return parser


if __name__ == "__main__":
    sys.exit(main())
