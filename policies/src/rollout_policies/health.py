"""The part of the standard health service, `grpc.health.v1`, that a policy
server needs. Its two messages have one field each and are encoded by hand here:
the package grpcio-health-checking needs newer protobuf versions than many policies'
environments have, and protobuf refuses to load a second copy of the generated messages."""

from __future__ import annotations

import grpc

SERVICES = ("", "rollout.policy.v1.Policy")
#: HealthCheckResponse{status = SERVING}: field 1, a varint, with value 1.
SERVING = b"\x08\x01"
#: HealthCheckRequest{service}: field 1, length-delimited.
SERVICE_TAG = 0x0A


def handler() -> grpc.GenericRpcHandler:
    """Answers Check; the streaming Watch is left unimplemented, as the standard allows."""
    return grpc.method_handlers_generic_handler(
        "grpc.health.v1.Health", {"Check": grpc.unary_unary_rpc_method_handler(_check)}
    )


def _check(request: bytes, context: grpc.ServicerContext) -> bytes:
    # The names served here are short enough for a length of one byte.
    has_length = len(request) > 1 and len(request) == 2 + request[1]
    if request and (request[0] != SERVICE_TAG or not has_length):
        context.abort(grpc.StatusCode.INVALID_ARGUMENT, "not a HealthCheckRequest")
    service = request[2:].decode("utf-8", errors="replace")
    if service not in SERVICES:
        context.abort(grpc.StatusCode.NOT_FOUND, f"no service {service!r} here")
    return SERVING
