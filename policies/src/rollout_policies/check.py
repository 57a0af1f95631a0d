"""Checks of a policy in its own process by the program `policy-gateway`."""

from __future__ import annotations

import os
import subprocess
import threading

from .policy import Policy, description_of
from .server import Server

#: Environment variable with the path of the program.
PROGRAM = "POLICY_GATEWAY"


class DoesNotConform(AssertionError):
    """A policy violates the protocol, or answers no query; the message is the program's output."""


def check(policy: Policy, *, suite: str = "libero_object") -> str:
    """Runs `policy-gateway check` on a policy in this process, for its unit tests.

    The policy is served on the loopback address, and its methods run in this thread, for episodes
    of a task of `suite`. The program is the one that the environment variable POLICY_GATEWAY names,
    else the one on the search path. Returns the program's output. Raises DoesNotConform, and
    FileNotFoundError without the program."""
    server = Server(policy, description_of(policy), "127.0.0.1:0")
    command = [os.environ.get(PROGRAM, "policy-gateway"), "check", f"grpc://{server.address}"]
    try:
        program = subprocess.Popen(
            [*command, "--suite", suite],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
    except BaseException:
        server.stop(0)
        raise
    output: list[str] = []

    def wait() -> None:
        output.append(program.communicate()[0])
        server.stop(0)

    thread = threading.Thread(target=wait, name="check", daemon=True)
    thread.start()
    server.work()
    thread.join()
    if program.returncode != 0:
        raise DoesNotConform(output[0])
    return output[0]
