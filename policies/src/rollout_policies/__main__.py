"""Serves one of the policies of the LIBERO-CTRL paper, or lists them.

    python -m rollout_policies list
    python -m rollout_policies serve smolvla --listen 127.0.0.1:5000
    python -m rollout_policies serve openvla-oft --suite libero_goal --listen 127.0.0.1:5001
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import sys

from .adapters import BATCHING, MODULES, NoBatches, Options, load
from .adapters.upstream import UnusableCheckpoint, UpstreamMissing
from .catalogue import Entry, NoCheckpoint, entries
from .server import serve


def main(arguments: list[str] | None = None) -> int:
    """Runs a command; returns its exit code: 2 for a wrong command line, 1 for
    what failed."""
    given = _parser().parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
    if given.command == "list":
        print("\n\n".join(_described(entry) for entry in entries().values()))
        return 0
    options = Options(
        checkpoint=given.checkpoint,
        suite=given.suite,
        device=given.device,
        max_batch=given.max_batch,
    )
    try:
        # Upstream packages print while they load; the first line of the output
        # is the address.
        with contextlib.redirect_stdout(sys.stderr):
            policy = load(given.policy, options)
        serve(policy, given.listen)
    except (NoCheckpoint, NoBatches) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except (UpstreamMissing, UnusableCheckpoint, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m rollout_policies", description=__doc__.splitlines()[0]
    )
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="the policies, their checkpoints and what they need")
    one = commands.add_parser("serve", help="load a policy and serve it")
    one.add_argument("policy", choices=list(MODULES))
    one.add_argument("--checkpoint", metavar="ID", help="hub id or local path of the weights")
    one.add_argument("--suite", help="which weights, where every suite has its own")
    one.add_argument("--device", default="cuda", help="as torch names it (default: cuda)")
    one.add_argument("--listen", default="127.0.0.1:0", metavar="ADDR", help="port 0: a free one")
    one.add_argument(
        "--max-batch",
        type=_positive,
        default=1,
        metavar="N",
        help=f"queries in one forward pass, for {' and '.join(BATCHING)}; moves low-order bits"
        " (default: 1)",
    )
    return parser


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is below 1")
    return number


def _described(entry: Entry) -> str:
    if entry.per_suite:
        weights = [f"  {suite}: {name}" for suite, name in entry.checkpoint.items()]
    else:
        weights = [f"  {entry.checkpoint}"]
    return "\n".join([f"{entry.name}  ({entry.title})", *weights, f"  needs: {entry.install}"])


if __name__ == "__main__":
    sys.exit(main())
