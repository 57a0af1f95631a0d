"""Serves a policy of the LIBERO-CTRL paper, or lists them.

    python -m rollout_policies list
    python -m rollout_policies serve smolvla --listen 127.0.0.1:5000
    python -m rollout_policies serve openvla-oft --suite libero_goal --device cuda:1
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import sys
import textwrap

from .access import AccessError, UnguardedAddress
from .adapters import BATCHING, EVALUATIONS, MODULES, WITH_SLOTS, WITH_STUDY, Options, load
from .adapters.cameras import ROLES
from .adapters.upstream import UnusableCheckpoint, UnusableOption, UpstreamMissing
from .catalogue import Entry, NoCheckpoint, entries
from .command import add_server_flags, server_options
from .server import require_servable, serve

#: Columns of the narrowest usual terminal.
TERMINAL_WIDTH = 80


def main(arguments: list[str] | None = None) -> int:
    """Runs a command and returns its exit code: 2 for an invalid command line,
    1 for a failure."""
    flags = _parser().parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
    if flags.command == "list":
        print("\n\n".join(_format_entry(entry) for entry in entries().values()))
        return 0
    options = Options(
        checkpoint=flags.checkpoint,
        revision=flags.revision,
        suite=flags.suite,
        device=flags.device,
        max_batch=flags.max_batch,
        execute=flags.execute,
        image_keys=flags.image_keys,
        evaluation=flags.evaluation,
    )
    try:
        serve_options = server_options(flags)
        require_servable(**serve_options)
        # Upstream packages print while they load, but the first line of stdout must be the address.
        with contextlib.redirect_stdout(sys.stderr):
            policy = load(flags.policy, options)
        serve(policy, **serve_options)
    except (IncompletePair, NoCheckpoint, UnusableOption, UnguardedAddress) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except (UpstreamMissing, UnusableCheckpoint, AccessError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m rollout_policies", description=__doc__.splitlines()[0]
    )
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="list the policies, their checkpoints and packages")
    server = commands.add_parser("serve", help="load a policy and serve it")
    server.add_argument("policy", choices=list(MODULES))
    server.add_argument(
        "--checkpoint",
        metavar="NAME",
        help="hub name (owner/repository or owner/repository/folder) or local path of the weights",
    )
    server.add_argument("--revision", metavar="REV", help="the hub's branch, tag or commit")
    server.add_argument("--suite", help="suite of the weights, if every suite has its own")
    server.add_argument("--device", default="cuda", help="torch's device name (default: cuda)")
    server.add_argument(
        "--execute",
        type=_positive,
        metavar="N",
        help="number of actions of a chunk that are executed before the next query (default:"
        " LIBERO-CTRL's number for the checkpoints of `list`, else the checkpoint's own)",
    )
    server.add_argument(
        "--image-keys",
        type=_image_keys,
        metavar="scene=SLOT,wrist=SLOT",
        help=f"image slots of the two cameras, for {', '.join(WITH_SLOTS)} (default: by"
        " the slots' names, if they are known)",
    )
    server.add_argument(
        "--evaluation",
        choices=EVALUATIONS,
        default=EVALUATIONS[0],
        help=f"evaluation protocol, for {', '.join(WITH_STUDY)}: the protocol of the policy's"
        " authors (upstream) or of LIBERO-CTRL (study) (default: upstream)",
    )
    add_server_flags(server)
    server.add_argument(
        "--max-batch",
        type=_positive,
        default=1,
        metavar="N",
        help=f"queries in one forward pass at most, for {' and '.join(BATCHING)}; changes low-order"
        " bits of actions (default: 1)",
    )
    return parser


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is below 1")
    return number


def _image_keys(text: str) -> dict[str, str]:
    pairs = [pair.partition("=")[::2] for pair in text.split(",")]
    keys = {role.strip(): slot.strip() for role, slot in pairs}
    if len(keys) != len(pairs) or not all(keys.values()) or not set(keys) <= set(ROLES):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not of the form scene=SLOT,wrist=SLOT (one of the two may be missing)"
        )
    return keys


def _format_entry(entry: Entry) -> str:
    if isinstance(entry.checkpoint, str):
        weights = [entry.checkpoint]
    else:
        weights = [f"{suite}: {name}" for suite, name in entry.checkpoint.items()]
    lines = [f"weights: {line}" for line in weights]
    lines += [f"also downloads: {name} ({text})" for name, text in entry.downloads.items()]
    lines.append(f"install: {entry.install}")
    wrapped = [
        textwrap.fill(
            line,
            TERMINAL_WIDTH,
            initial_indent="  ",
            subsequent_indent="    ",
            break_long_words=False,
            break_on_hyphens=False,
        )
        for line in lines
    ]
    return "\n".join([f"{entry.name}  ({entry.title})", *wrapped])


if __name__ == "__main__":
    sys.exit(main())
