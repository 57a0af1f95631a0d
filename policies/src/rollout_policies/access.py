"""Access control of a server: the certificate, the tokens, and the rule that an address reachable
from other machines needs both. Token files have the same form, and refusals the same texts, as
those of the gateway's server."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import logging
import os
import socket
import ssl
import stat
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import grpc

ROLES = ("worker", "operator", "viewer")
#: Roles that may query a policy.
QUERYING_ROLES = ("worker", "operator")
#: Shortest and longest token, bytes; largest number of tokens in a file, and largest file, bytes.
MIN_TOKEN_BYTES, MAX_TOKEN_BYTES = 16, 256
MAX_TOKENS = 256
MAX_TOKEN_FILE_BYTES = 128 << 10
#: Environment variable that holds the lines of a token file.
TOKENS_VARIABLE = "ROLLOUT_TOKENS"
#: Method prefix of the health service, which needs no token.
HEALTH_PATH = "/grpc.health.v1.Health/"
#: Interval after which a refusal of the same kind to the same machine is logged again, s.
LOGGED_AGAIN_SECS = 600.0
#: Largest number of pairs of machine and kind of refusal whose last log time is stored.
MAX_LOGGED = 1024

log = logging.getLogger("rollout_policies")


class AccessError(ValueError):
    """The certificate, key or tokens cannot be used. The message never contains a token."""


class IncompletePair(ValueError):
    """A certificate without its key, or a key without its certificate."""


class UnguardedAddress(ValueError):
    """Other machines could connect, but TLS or tokens are missing."""


@dataclass(frozen=True)
class Tokens:
    """Tokens with their roles, in the order of their file."""

    entries: tuple[tuple[str, str], ...]

    def __repr__(self) -> str:
        return f"Tokens({len(self.entries)})"

    @classmethod
    def read(cls, path: str | Path) -> Tokens:
        """Reads a token file: one `ROLE TOKEN` per line, empty lines and those
        that begin with `#` skipped. Raises AccessError."""
        try:
            with open(path, "rb") as file:
                _require_private("token file", path, os.fstat(file.fileno()))
                data = file.read(MAX_TOKEN_FILE_BYTES + 1)
            if len(data) > MAX_TOKEN_FILE_BYTES:
                raise AccessError(
                    f"failed to read token file {path}: it is larger than"
                    f" {MAX_TOKEN_FILE_BYTES} bytes"
                )
            text = data.decode("utf-8")
        except OSError as error:
            raise AccessError(f"failed to read token file {path}: {error.strerror}") from error
        except UnicodeDecodeError:
            raise AccessError(f"failed to read token file {path}: it is not UTF-8") from None
        return cls.parse(text, f"token file {path}")

    @classmethod
    def parse(cls, text: str, place: str) -> Tokens:
        """Reads the text of a token file. Raises AccessError, which names the
        place and the line."""
        entries = []
        for number, line in enumerate(text.splitlines(), 1):
            words = line.split()
            if not words or words[0].startswith("#"):
                continue
            problem = _line_problem(words)
            if problem:
                raise AccessError(
                    f"failed to read line {number} of {place}: {problem}; write one `ROLE TOKEN`"
                    " per line, the role being worker, operator or viewer"
                )
            entries.append((words[0], words[1]))
        if not entries:
            raise AccessError(f"failed to find a token in {place}: write one `ROLE TOKEN` per line")
        if len(entries) > MAX_TOKENS:
            raise AccessError(f"failed to read {place}: it holds more than {MAX_TOKENS} tokens")
        return cls(tuple(entries))

    def role_of(self, presented: str) -> str | None:
        """Returns the role of the token that a caller presented, or None. Compares tokens in
        constant time."""
        digest = _digest(presented)
        matched_role = None
        for role, token in self.entries:
            if hmac.compare_digest(digest, _digest(token)):
                matched_role = role
        return matched_role


def _require_private(kind: str, path: str | Path, status: os.stat_result) -> None:
    """Refuses a file of secrets that other users can read or write; the gateway has the same rule.
    The group may have access only if the file belongs to another user."""
    if not hasattr(os, "geteuid"):
        return  # Windows has no such permission bits.
    is_own = status.st_uid == os.geteuid()
    refused_bits, permitted = (0o077, "600") if is_own else (0o007, "o=")
    if stat.S_ISREG(status.st_mode) and status.st_mode & refused_bits:
        raise AccessError(
            f"failed to read {kind} {path}: its permissions, {status.st_mode & 0o777:04o}, let"
            f" other users access it; restrict them with `chmod {permitted} {path}`"
        )


def _line_problem(words: list[str]) -> str | None:
    """Returns the reason why the words of a line are not a role and a token; None if they are."""
    if len(words) != 2:
        return "it is not two words"
    role, token = words
    if role not in ROLES:
        return "its first word is not a role"
    if len(token) < MIN_TOKEN_BYTES:
        return "the token is too short to be a secret: take 32 random hex digits"
    if len(token) > MAX_TOKEN_BYTES:
        return "the token is too long"
    if not all("!" <= character <= "~" for character in token):
        return "the token holds something other than visible ASCII characters"
    return None


def _digest(secret: str) -> bytes:
    return hashlib.sha256(secret.encode("utf-8", "surrogateescape")).digest()


def read_tokens(path: str | Path | None) -> Tokens | None:
    """Returns the tokens of a file, else of the environment, else None."""
    if path is not None:
        return Tokens.read(path)
    text = os.environ.get(TOKENS_VARIABLE)
    return Tokens.parse(text, TOKENS_VARIABLE) if text else None


def server_credentials(certificate: str | Path, key: str | Path) -> grpc.ServerCredentials:
    """Returns the server's TLS credentials. Raises AccessError."""
    try:
        # gRPC itself would only log that certificate and key do not match.
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        with open(key, "rb") as file:
            _require_private("private key", key, os.fstat(file.fileno()))
        context.load_cert_chain(certificate, key, password="")
        pair = Path(key).read_bytes(), Path(certificate).read_bytes()
    except OSError as error:
        raise AccessError(
            f"failed to use certificate {certificate} and key {key} ({error.strerror or error}):"
            " give a PEM chain, and the private key of its first certificate, as PEM"
        ) from error
    return grpc.ssl_server_credentials([pair])


def is_loopback(host: str) -> bool:
    """Returns True if only this machine can reach the host."""
    host = host.strip("[]")
    try:
        resolved = {info[4][0] for info in socket.getaddrinfo(host or "0.0.0.0", None)}
    except OSError:
        # Listening on the host fails later, with a better message.
        return False
    addresses = [ipaddress.ip_address(str(address).partition("%")[0]) for address in resolved]
    mapped = [getattr(address, "ipv4_mapped", None) or address for address in addresses]
    return all(address.is_loopback for address in mapped)


def require_guarded(listen: str, encrypted: bool, tokens: Tokens | None) -> None:
    """Refuses an address that other machines can reach if TLS or the tokens are missing. Raises
    UnguardedAddress."""
    if encrypted and tokens:
        return
    if is_loopback(listen.rpartition(":")[0]):
        return
    risk = "every client would be admitted, in the clear"
    if encrypted:
        risk = "every client would be admitted without a token"
    elif tokens:
        risk = "tokens would be sent in the clear"
    raise UnguardedAddress(
        f"failed to listen on {listen}: other machines can reach that, and {risk}; give"
        " --tls-cert, --tls-key and --token-file, or --insecure if only trusted people reach this"
        " network (in Python: tls, token_file, insecure)"
    )


class TokenGate(grpc.ServerInterceptor):
    """Requires a token whose role may query policies."""

    def __init__(self, tokens: Tokens) -> None:
        self._tokens = tokens
        self._lock = threading.Lock()
        self._logged: dict[tuple[str, grpc.StatusCode], float] = {}

    def intercept_service(self, continuation, handler_call_details):
        if handler_call_details.method.startswith(HEALTH_PATH):
            return continuation(handler_call_details)
        header = dict(handler_call_details.invocation_metadata or ()).get("authorization", "")
        if not isinstance(header, str) or not header.startswith("Bearer "):
            return self._refusal(
                grpc.StatusCode.UNAUTHENTICATED,
                "let the caller in without a token: name a --token-file (the token is sent"
                " only over https:// or to this machine)",
            )
        role = self._tokens.role_of(header[len("Bearer ") :])
        if role is None:
            return self._refusal(
                grpc.StatusCode.UNAUTHENTICATED,
                "let the caller in: this server does not know the token",
            )
        if role not in QUERYING_ROLES:
            return self._refusal(
                grpc.StatusCode.PERMISSION_DENIED,
                f"do this with the token of a {role}: queries need the token of a"
                f" {' or '.join(QUERYING_ROLES)}",
            )
        return continuation(handler_call_details)

    def _refusal(self, code: grpc.StatusCode, reason: str) -> grpc.RpcMethodHandler:
        def refuse(_request, context):
            peer = context.peer().rpartition(":")[0]
            if self._should_log(peer, code):
                log.warning(
                    "a request from %s was refused: failed to %s (further refusals of this kind to"
                    " the same machine are not logged for ten minutes)",
                    peer,
                    reason,
                )
            context.abort(code, reason)

        return grpc.unary_unary_rpc_method_handler(refuse)

    def _should_log(self, peer: str, code: grpc.StatusCode) -> bool:
        now = time.monotonic()
        with self._lock:
            if now - self._logged.get((peer, code), -LOGGED_AGAIN_SECS) < LOGGED_AGAIN_SECS:
                return False
            if len(self._logged) >= MAX_LOGGED:
                self._logged.clear()
            self._logged[peer, code] = now
            return True
