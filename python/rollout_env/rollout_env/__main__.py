"""`python -m rollout_env serve|describe|check|calibrate SPEC`."""

from __future__ import annotations

import argparse
import json
import os
import sys

import numpy as np

from . import open_simulator, serve
from .calibrate import calibrate
from .check import check
from .description import Failed, Unusable
from .settings import arguments, settings

COMMANDS = {
    "serve": "serve the program that starts this command",
    "describe": "print the answer to Describe, JSON",
    "check": "name what is wrong with an environment, with the remedy",
    "calibrate": "measure σ of the actuation axis",
}


def main(given: list[str] | None = None) -> int:
    """Runs a command; returns its exit code."""
    parser = argparse.ArgumentParser(
        "rollout-env", description="Serves a simulator through a pipe."
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for name, text in COMMANDS.items():
        command = commands.add_parser(name, help=text, description=text)
        arguments(command)
        if name == "calibrate":
            command.add_argument(
                "--demonstrations",
                metavar="FILE",
                required=True,
                help=".npz with the actions of each demonstration, -1 to 1, as TASK@SEED",
            )
            command.add_argument(
                "--position", default="eef_pos", help="reading of the end-effector's position"
            )
            command.add_argument(
                "--mm", type=float, default=1000.0, help="millimetres per unit of the position"
            )
    options = parser.parse_args(given)
    # MuJoCo draws without a screen; an explicit choice stays.
    os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        return _run(options)
    except (Unusable, Failed) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


def _run(options: argparse.Namespace) -> int:
    if options.command == "serve":
        # A wrong option too is answered to Describe, so that the worker can report it.
        serve(lambda: open_simulator(settings(options)))
        return 0
    chosen = settings(options)
    if options.command == "check":
        findings = list(check(lambda: open_simulator(chosen)))
        for finding in findings:
            print(f"{'error' if finding.is_error else 'note'}: {finding.name}: {finding.text}")
        failed = any(finding.is_error for finding in findings)
        print(f"{chosen.spec}: {'not usable as it is' if failed else 'conforms'}")
        return int(failed)
    simulator = open_simulator(chosen)
    if options.command == "describe":
        answer = simulator.description.to_json()
    else:
        with np.load(options.demonstrations) as file:
            actions = dict(file)
        answer = calibrate(simulator, actions, options.position, options.mm)
    simulator.close()
    print(json.dumps(answer, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
