"""Diagnosis of a failed call. gRPC's own errors do not say which kind of server is at the URL, so
a client that got no answer connects again without gRPC and reads the reply."""

from __future__ import annotations

import socket
import ssl
from dataclasses import dataclass

import grpc

from .access import Access
from .channel import channel

#: Longest wait for each answer, s.
ANSWER_TIMEOUT = 3.0
#: First bytes of an HTTP/2 client: its preface, and an empty SETTINGS frame.
PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0"
#: Bytes of an HTTP/2 frame's header, position of its type, and the type SETTINGS.
FRAME_HEAD, FRAME_TYPE, SETTINGS_FRAME = 9, 3, 4
#: Characters of a server's reply that are quoted.
QUOTED_CHARS = 60
#: HTTP statuses of a proxy that cannot reach its server.
PROXY_STATUSES = ("502", "503", "504")
#: Calls without side effects that identify a kind of server: only a coordinator implements the
#: first, and only a policy server or gateway the second.
COORDINATOR_CALL = "/rollout.coordinator.v1.OperatorService/ListCampaigns"
POLICY_CALL = "/rollout.policy.v1.Policy/Describe"
#: Start of gRPC's message about an answer from a web server.
WEB_ANSWER = "Received http2 header with status: "
#: OpenSSL's error numbers for certificates.
NOT_YET_VALID, EXPIRED = 9, 10
UNTRUSTED = (2, 7, 18, 19, 20, 21)
OTHER_NAME = (62, 64)

GIVE_ADDRESS = "give Client the address of the coordinator"


@dataclass(frozen=True)
class Finding:
    """Description of the server at a URL, or of the failed connection to it, with a remedy."""

    words: str
    remedy: str
    #: True if settings are wrong, so that trying again changes nothing.
    is_final: bool


#: The coordinator answers the diagnosis: only the failed call lost its connection.
BROKEN = Finding(
    "the connection ended before the answer came",
    "try again; if the coordinator failed, its log says why",
    is_final=False,
)
OLDER = Finding(
    "the coordinator there does not have this call",
    "install the release of rollout-libero that the coordinator has, or upgrade the coordinator",
    is_final=True,
)
ENCRYPTED = Finding(
    "the server there uses TLS",
    "write https:// in place of http://, and name its certificate authority with `ca`",
    is_final=True,
)
CLEAR = Finding(
    "the server there does not use TLS",
    "write http:// in place of https://, or start the coordinator with --tls-cert and --tls-key",
    is_final=True,
)
SLOW = Finding(
    f"an HTTP/2 server there leaves a call unanswered for {ANSWER_TIMEOUT:g} s",
    "check that the URL names the port of the coordinator, and try again if its machine is busy",
    is_final=False,
)
SILENT = Finding(
    "the server there closes the connection or sends nothing",
    "check that the URL names the port of the coordinator",
    is_final=False,
)


def identify_server(access: Access) -> Finding:
    """Connects with the client's settings, and describes the server within a few seconds."""
    try:
        connection = socket.create_connection((access.host, access.port), timeout=ANSWER_TIMEOUT)
    except OSError as error:
        return _no_connection(access, error)
    if access.is_encrypted:
        with connection:
            try:
                finding = _read_reply(
                    _context(access).wrap_socket(connection, server_hostname=access.host)
                )
            except ssl.SSLCertVerificationError as error:
                return _certificate_finding(access, error)
            except OSError:
                # The server does not use TLS, or supports none of this client's versions.
                return _identify_without_tls(access)
        return finding or _identify_grpc_server(access)
    with connection:
        finding = _read_reply(connection)
    if finding is SILENT and _accepts_tls(access):
        return ENCRYPTED
    return finding or _identify_grpc_server(access)


def _no_connection(access: Access, error: OSError) -> Finding:
    if isinstance(error, socket.gaierror):
        words = f"no address is known for the name `{access.host}`"
        return Finding(words, "correct the host's name in the URL", is_final=False)
    if isinstance(error, ConnectionRefusedError):
        remedy = f"start it with `coordinator serve`, or {GIVE_ADDRESS}"
        return Finding("nothing listens there", remedy, is_final=False)
    return Finding(
        f"the machine does not answer ({error.strerror or 'timed out'})",
        "check that the machine is running and that no firewall blocks the connection, or"
        f" {GIVE_ADDRESS}",
        is_final=False,
    )


def _context(access: Access) -> ssl.SSLContext:
    authority = access.authority
    context = ssl.create_default_context(cadata=authority.decode("ascii") if authority else None)
    # gRPC has lower requirements on certificates than the newest Pythons.
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT
    context.set_alpn_protocols(["h2"])
    return context


def _certificate_finding(access: Access, error: ssl.SSLCertVerificationError) -> Finding:
    if error.verify_code in UNTRUSTED:
        words = "its certificate was signed by an authority that is not known here"
        if access.ca is not None:
            words = f"its certificate was not signed by the authority in {access.ca}"
        remedy = "name with `ca` the certificate of the authority that signed it"
    elif error.verify_code in OTHER_NAME:
        words = f"its certificate is not for `{access.host}`"
        remedy = (
            "write a host name of the certificate in the URL, or start the coordinator with a"
            f" certificate for `{access.host}`"
        )
    elif error.verify_code == EXPIRED:
        words = "its certificate has expired"
        remedy = "start the coordinator with a new certificate in --tls-cert"
    elif error.verify_code == NOT_YET_VALID:
        words = "its certificate is not valid yet"
        remedy = "correct the clocks of both machines"
    else:
        words = f"its certificate cannot be used ({error.verify_message})"
        remedy = "start the coordinator with its own certificate, as docs/OPERATING.md describes"
    return Finding(words, remedy, is_final=True)


def _identify_without_tls(access: Access) -> Finding:
    """Connects without TLS, and describes a server that completes no TLS handshake."""
    try:
        with socket.create_connection(
            (access.host, access.port), timeout=ANSWER_TIMEOUT
        ) as connection:
            finding = _read_reply(connection)
    except OSError:
        return SILENT
    # The reply is HTTP/1 or HTTP/2 without TLS.
    return CLEAR if finding is None or "web server" in finding.words else finding


def _accepts_tls(access: Access) -> bool:
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    try:
        with socket.create_connection(
            (access.host, access.port), timeout=ANSWER_TIMEOUT
        ) as connection:
            context.wrap_socket(connection, server_hostname=access.host).close()
    except OSError:
        return False
    return True


def _read_reply(connection: socket.socket) -> Finding | None:
    """Sends an HTTP/2 client's preface, and describes the reply; None if the reply is HTTP/2."""
    reply = b""
    connection.settimeout(ANSWER_TIMEOUT)
    try:
        # A server may have sent a reply before it closes the connection because of the preface.
        connection.sendall(PREFACE)
        while len(reply) < FRAME_HEAD and (more := connection.recv(128)):
            reply += more
    except OSError:
        pass
    return _describe_reply(reply)


def _describe_reply(reply: bytes) -> Finding | None:
    line = reply.decode("utf-8", "replace").partition("\n")[0]
    quoted = "".join(character for character in line if character.isprintable())[:QUOTED_CHARS]
    if not reply:
        return SILENT
    if reply[:1] in (b"\x15", b"\x16") and reply[1:2] == b"\x03":
        return ENCRYPTED
    if reply.startswith(b"SSH-"):
        return _wrong_server("an SSH server is there")
    if reply.startswith((b"HTTP/", b"<")):
        return _web_server(quoted)
    if reply[:1] == b"\0" and reply[FRAME_TYPE : FRAME_TYPE + 1] == bytes([SETTINGS_FRAME]):
        return None
    return _wrong_server(f"a server of another kind is there, whose answer begins with {quoted!r}")


def _wrong_server(words: str) -> Finding:
    return Finding(words, GIVE_ADDRESS, is_final=True)


def _web_server(status_line: str) -> Finding:
    if any(status in status_line.split() for status in PROXY_STATUSES):
        words = f"a proxy there cannot reach the server behind it ({status_line})"
        return Finding(words, "start it with `coordinator serve`", is_final=False)
    return _wrong_server(f"a web server of another kind is there ({status_line})")


def _identify_grpc_server(access: Access) -> Finding:
    """Describes an HTTP/2 server by the gRPC methods that it implements."""
    with channel(access) as opened:
        is_coordinator = _has_call(opened, access, COORDINATOR_CALL)
        if is_coordinator is True:
            return BROKEN
        if isinstance(is_coordinator, Finding):
            return is_coordinator
        if _has_call(opened, access, POLICY_CALL) is True:
            return _wrong_server("a policy server or policy-gateway is there, not a coordinator")
    return _wrong_server("a gRPC server is there, and it is not a coordinator")


def _has_call(opened: grpc.Channel, access: Access, path: str) -> bool | Finding:
    """Returns False if a gRPC server lacks the method `path`, a description of a server that does
    not answer in time or is a web server, and True otherwise, even if the call fails."""
    call = opened.unary_unary(path, request_serializer=None, response_deserializer=None)
    try:
        call(b"", timeout=ANSWER_TIMEOUT, metadata=access.metadata)
    except grpc.RpcError as error:
        details = error.details() or ""
        if details.startswith(WEB_ANSWER):
            return _web_server(f"HTTP status {details.removeprefix(WEB_ANSWER)}")
        if error.code() is grpc.StatusCode.DEADLINE_EXCEEDED:
            return SLOW
        return error.code() is not grpc.StatusCode.UNIMPLEMENTED
    return True
