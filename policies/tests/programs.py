"""Context managers that run a server, or a gateway with a client, as separate processes.

The gateway is the program that the environment variable POLICY_GATEWAY names."""

import contextlib
import os
import subprocess

import pytest
from conftest import Client


@contextlib.contextmanager
def running(command):
    """Runs a program whose first line is `listening on ADDRESS`; yields the address."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline()
        assert line.startswith("listening on "), line
        yield line.split()[2]
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def gateway_program():
    program = os.environ.get("POLICY_GATEWAY")
    if program is None:
        pytest.skip("POLICY_GATEWAY does not name the policy-gateway program")
    return program


@contextlib.contextmanager
def client_behind(program, *arguments):
    """Runs a gateway with these arguments; yields a client of it."""
    with running([program, "--listen", "127.0.0.1:0", *arguments]) as address:
        client = Client(address)
        yield client
        client.channel.close()
