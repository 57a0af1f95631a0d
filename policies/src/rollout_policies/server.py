"""A policy's server: its port, threads, start and shutdown."""

from __future__ import annotations

import contextlib
import errno
import re
import signal
import socket
import sys
import threading
import time
from concurrent import futures
from pathlib import Path

import grpc

from . import health
from .access import TokenGate, Tokens, read_tokens, require_guarded, server_credentials
from .description import MAX_MESSAGE_BYTES, Description
from .inference import InferenceThread
from .policy import Policy, description_of
from .service import PolicyService
from .sessions import SessionTable

#: Largest number of requests that are waiting or being answered; further requests are refused.
MAX_CONCURRENT_RPCS = 256
#: Time that open requests have to finish after the stop signal.
SHUTDOWN_GRACE_SECS = 10.0
#: Interval between searches for idle episodes.
SWEEP_SECS = 30.0


class CannotListen(OSError):
    """An address is invalid, or its port is taken."""


class Server:
    """A server of one policy, whose calls are made by the thread in `work`."""

    def __init__(
        self,
        policy: Policy,
        description: Description,
        listen: str,
        credentials: grpc.ServerCredentials | None = None,
        tokens: Tokens | None = None,
    ) -> None:
        self._inference = InferenceThread()
        self._service = PolicyService(policy, description, self._inference, SessionTable())
        self._thread: threading.Thread | None = None
        self._server = grpc.server(
            futures.ThreadPoolExecutor(max_workers=MAX_CONCURRENT_RPCS),
            maximum_concurrent_rpcs=MAX_CONCURRENT_RPCS,
            interceptors=[TokenGate(tokens)] if tokens else [],
            options=[
                ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
                ("grpc.max_send_message_length", MAX_MESSAGE_BYTES),
                # Without this, a second server on the same port would receive part of the requests.
                ("grpc.so_reuseport", 0),
            ],
        )
        self._server.add_generic_rpc_handlers((self._service.handler(), health.handler()))
        try:
            if credentials is None:
                port = self._server.add_insecure_port(listen)
            else:
                port = self._server.add_secure_port(listen, credentials)
        except RuntimeError as error:
            raise CannotListen(f"failed to listen on {listen}: {error}") from error
        if port == 0:
            raise CannotListen(
                f"failed to listen on {listen}: the port is taken, or the host is no address of"
                " this machine"
            )
        #: host:port, with the port that was assigned.
        self.address = f"{listen.rpartition(':')[0]}:{port}"
        self._server.start()

    def work(self) -> None:
        """Calls the policy in this thread until `stop`."""
        self._inference.work(self._service.close_idle, SWEEP_SECS)

    def work_in_background(self) -> None:
        """Calls the policy in a separate thread."""
        self._thread = threading.Thread(target=self.work, name="inference", daemon=True)
        self._thread.start()

    def stop(self, grace_secs: float = SHUTDOWN_GRACE_SECS) -> None:
        """Frees the port. Returns when the open requests have finished or `grace_secs` are over
        and, after `work_in_background`, the policy's current call has ended."""
        self._server.stop(grace_secs).wait()
        self._inference.close()
        if self._thread is not None:
            self._thread.join()

    def wait(self) -> None:
        """Returns when the server has stopped."""
        self._server.wait_for_termination()


def start(policy: Policy, listen: str = "127.0.0.1:0") -> Server:
    """Serves a policy in the background, to this machine only; for tests and notebooks. Port 0
    selects a free one.

    The policy is called in a thread of the server. A model that must stay in the thread that
    created it needs `serve`. `warm_up` is not called."""
    _require_address(listen)
    require_guarded(listen, encrypted=False, tokens=None)
    server = Server(policy, description_of(policy), listen)
    server.work_in_background()
    return server


def serve(
    policy: Policy,
    listen: str = "127.0.0.1:0",
    *,
    tls: tuple[str | Path, str | Path] | None = None,
    token_file: str | Path | None = None,
    insecure: bool = False,
) -> None:
    """Serves a policy until SIGTERM or SIGINT, and calls it in this thread.

    Prints the resolved settings to stderr, warms the policy up, and prints the address as one line
    to stdout. `tls` holds the files of a certificate chain and its key; `token_file` has a line
    `ROLE TOKEN` for each accepted token (or ROLLOUT_TOKENS has these lines). An address that other
    machines can reach needs both, or `insecure`.

    Raises UnusableDescription, UnguardedAddress, AccessError, CannotListen, and
    exceptions of the warm-up."""
    description = description_of(policy)
    credentials, tokens = require_servable(listen, tls, token_file, insecure)
    for line in description.lines():
        print(line, file=sys.stderr)
    began = time.monotonic()
    print("warming up", file=sys.stderr, flush=True)
    # Models print while they compile, but the first line of stdout must be the address.
    with contextlib.redirect_stdout(sys.stderr):
        policy.warm_up()
    print(f"warm after {time.monotonic() - began:.1f} s", file=sys.stderr, flush=True)

    server = Server(policy, description, listen, credentials, tokens)
    for number in (signal.SIGTERM, signal.SIGINT):
        # Another thread stops the server, because `stop` waits for the open requests, and this
        # thread answers them.
        signal.signal(number, lambda *_: threading.Thread(target=server.stop).start())
    over = "" if credentials is None else " over TLS"
    print(f"listening on {server.address}{over}", flush=True)
    server.work()


def require_servable(
    listen: str,
    tls: tuple[str | Path, str | Path] | None,
    token_file: str | Path | None,
    insecure: bool,
) -> tuple[grpc.ServerCredentials | None, Tokens | None]:
    """Checks the arguments of `serve`, so that their errors show before weights are loaded.

    Returns the server's credentials and tokens. Raises UnguardedAddress, AccessError,
    CannotListen."""
    _require_address(listen)
    tokens = read_tokens(token_file)
    credentials = None if tls is None else server_credentials(*tls)
    if not insecure:
        require_guarded(listen, encrypted=credentials is not None, tokens=tokens)
    _require_free(listen)
    return credentials, tokens


def _require_address(listen: str) -> None:
    if not re.search(r":\d+$", listen):
        raise CannotListen(f"failed to read {listen!r} as an address to listen on: write HOST:PORT")


def _require_free(listen: str) -> None:
    """Detects a taken port before a long warm-up. The port stays closed during the warm-up, so
    that callers are refused rather than kept waiting."""
    host, _, port = listen.rpartition(":")
    try:
        [family, kind, number, _, address], *_ = socket.getaddrinfo(
            host.strip("[]") or None, int(port), type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )
        with socket.socket(family, kind, number) as tried:
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind(address)
    except OSError as error:
        # gRPC, which tries every address of a name, reports other errors better.
        if error.errno in (errno.EADDRINUSE, errno.EACCES):
            raise CannotListen(f"failed to listen on {listen}: {error.strerror}") from error
