"""A gRPC connection with the same options as the command line's."""

from __future__ import annotations

import grpc

from .access import Access


def channel(access: Access) -> grpc.Channel:
    """Returns a channel that connects at the first call."""
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
