"""An operator's calls: they are retried while the coordinator cannot be reached, and a refusal by
the coordinator is distinguished from a failed connection."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable
from typing import Any, TypeVar

import grpc

from .access import Access
from .errors import (
    AccessDeniedError,
    CoordinatorError,
    NoSuchCampaignError,
    RefusedError,
    UnreachableError,
)
from .proto import coordinator_pb2 as wire

#: First and longest pause between two tries, s. Each pause is twice as long as the previous one.
FIRST_PAUSE, LONGEST_PAUSE = 0.25, 4.0
#: Longest wait for an answer that is a single message, s.
ANSWER_TIMEOUT = 60.0
#: Status codes that may mean a connection failure; all other codes come from a server.
CONNECTION_CODES = (
    grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.UNIMPLEMENTED, grpc.StatusCode.DEADLINE_EXCEEDED,
    grpc.StatusCode.CANCELLED, grpc.StatusCode.INTERNAL, grpc.StatusCode.UNKNOWN,
)  # fmt: skip

#: Start of gRPC's message about an answer from a web server.
WEB_ANSWER = "Received http2 header with status: "
INSTALL = "name the coordinator's address, and install its release of rollout-libero"
#: The operator's calls.
SERVICE = wire.DESCRIPTOR.services_by_name["OperatorService"]

log = logging.getLogger("rollout_client")

T = TypeVar("T")


class Connection:
    """A connection to a coordinator, opened at the first call. Threads may share it."""

    def __init__(self, access: Access, retry_secs: float) -> None:
        self.access = access
        self.retry_secs = retry_secs
        self._channel = _channel(access)

    def close(self) -> None:
        """Closes the connection. Later calls fail."""
        self._channel.close()

    def campaign(self, name: str) -> dict[str, Any]:
        """Returns a campaign's status."""
        status: dict[str, Any] = self.call("GetCampaign", wire.GetCampaignRequest(campaign=name))
        return status

    def call(self, name: str, request: object) -> Any:
        """Calls a method until the coordinator answers, the time for retries is over, or a retry
        could not help; returns the value of the answer's JSON. All operator calls may be repeated
        safely. Raises CoordinatorError."""
        method = self._method(self._channel.unary_unary, name)
        answer = self._with_retries(
            lambda: method(request, timeout=ANSWER_TIMEOUT, metadata=self.access.metadata)
        )
        return json.loads(answer.json)

    def collect(self, name: str, request: object) -> list[Any]:
        """Like `call`, for a method whose answer is a stream."""
        method = self._method(self._channel.unary_stream, name)
        return self._with_retries(lambda: list(method(request, metadata=self.access.metadata)))

    def _method(self, kind: Callable[..., Any], name: str) -> Callable[..., Any]:
        answer = getattr(wire, SERVICE.methods_by_name[name].output_type.name)
        return kind(  # type: ignore[no-any-return]
            f"/{SERVICE.full_name}/{name}",
            request_serializer=lambda request: request.SerializeToString(),
            response_deserializer=answer.FromString,
        )

    def _with_retries(self, send: Callable[[], T]) -> T:
        deadline = time.monotonic() + self.retry_secs
        pause = FIRST_PAUSE
        has_warned = False
        while True:
            try:
                return send()
            except grpc.RpcError as error:
                lost = self._lost(error)
                failure = lost or _refusal(error)
                is_temporary = (
                    error.code() is grpc.StatusCode.UNAVAILABLE
                    if lost is None
                    else lost.remedy is not INSTALL
                )
            if not is_temporary or time.monotonic() + pause > deadline:
                raise failure
            if not has_warned:
                has_warned = True
                log.warning("%s; trying again for %g s", failure, self.retry_secs)
            time.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE)

    def _lost(self, error: grpc.RpcError) -> UnreachableError | None:
        """Returns the error of a call that did not reach a coordinator; None if one answered."""
        code, details = error.code(), error.details() or error.code().name
        is_from_web_server = details.startswith(WEB_ANSWER)
        # Only a server's answers have trailing metadata; this client's own errors have none.
        has_answered = bool(error.trailing_metadata()) and not is_from_web_server
        if code is grpc.StatusCode.UNIMPLEMENTED:
            found = "the server there is not a coordinator, or has another release"
            return UnreachableError(self.access.url, found, INSTALL)
        if has_answered or not is_from_web_server and code not in CONNECTION_CODES:
            return None
        remedy = (
            "start it with `coordinator serve`, or find out what is there with"
            f" `coordinator campaign status --connect {self.access.url}`"
        )
        return UnreachableError(self.access.url, details, remedy)


def _refusal(error: grpc.RpcError) -> CoordinatorError:
    """Converts a coordinator's error to an exception with its message."""
    code = error.code()
    details = error.details() or f"complete the call: gRPC status {code.name}, without a reason"
    message = f"failed to {details}"
    if code in (grpc.StatusCode.UNAUTHENTICATED, grpc.StatusCode.PERMISSION_DENIED):
        return AccessDeniedError(f"{message} (in Python: `token_file`)")
    if code is grpc.StatusCode.NOT_FOUND:
        return NoSuchCampaignError(message)
    return RefusedError(message)


def _channel(access: Access) -> grpc.Channel:
    """Returns a channel that connects at the first call, with the command line's options."""
    options = [
        # As on the command line, messages may be large enough for the lists of large campaigns,
        # and no proxy is used.
        ("grpc.max_receive_message_length", 32 << 20),
        ("grpc.max_send_message_length", 32 << 20),
        ("grpc.enable_http_proxy", 0),
        ("grpc.initial_reconnect_backoff_ms", 250),
        ("grpc.max_reconnect_backoff_ms", 4_000),
        # Despite its name, the shortest timeout of an attempt to connect, not a back-off.
        ("grpc.min_reconnect_backoff_ms", 5_000),
        # Each channel has its own connection, which failures of another channel do not affect.
        ("grpc.use_local_subchannel_pool", 1),
    ]
    if not access.is_encrypted:
        return grpc.insecure_channel(access.target, options=options)
    credentials = grpc.ssl_channel_credentials(root_certificates=access.authority)
    return grpc.secure_channel(access.target, credentials, options=options)
