"""The address of a coordinator, and a client's credentials: the certificate authority that the
client trusts, and its token. The command line uses the same files and environment variables."""

from __future__ import annotations

import ipaddress
import os
import ssl
import stat
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

from .errors import SettingsError

#: Environment variables, shared with the command line.
URL_VARIABLE = "COORDINATOR_URL"
TOKEN_FILE_VARIABLE = "ROLLOUT_TOKEN_FILE"
TOKENS_VARIABLE = "ROLLOUT_TOKENS"
CA_VARIABLE = "ROLLOUT_CA"
DEFAULT_URL = "http://127.0.0.1:7411"
#: Roles in order of preference: a client uses the first role for which it has a token. An operator
#: may also read campaigns.
ROLES = ("operator", "viewer")
ALL_ROLES = ("worker", *ROLES)
#: URL schemes; True for a scheme that implies TLS.
SCHEMES = {"http": False, "grpc": False, "https": True, "grpcs": True}


@dataclass(frozen=True)
class Access:
    """A coordinator's address, and a client's credentials."""

    #: URL as given.
    url: str
    #: Host without brackets.
    host: str
    port: int
    is_encrypted: bool
    #: Certificates of the authority that signed the coordinator's certificate, PEM.
    authority: bytes | None
    #: Token, never printed.
    token: str | None = field(repr=False)
    #: Paths of the token file and authority, for a program that reads them itself.
    token_file: Path | None
    ca: Path | None

    @property
    def target(self) -> str:
        """The address in gRPC's form."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"

    @property
    def metadata(self) -> tuple[tuple[str, str], ...]:
        """Metadata of every call. The token is only sent over TLS or to this machine."""
        if self.token is None or not (self.is_encrypted or _is_this_machine(self.host)):
            return ()
        return (("authorization", f"Bearer {self.token}"),)


def read(
    url: str | None, token_file: str | os.PathLike[str] | None, ca: str | os.PathLike[str] | None
) -> Access:
    """Reads the given arguments, else the environment. Raises SettingsError."""
    url = url or os.environ.get(URL_VARIABLE) or DEFAULT_URL
    host, port, is_encrypted = _address(url)
    token_path = _path(token_file, TOKEN_FILE_VARIABLE)
    ca_path = _path(ca, CA_VARIABLE)
    return Access(
        url=url,
        host=host,
        port=port,
        is_encrypted=is_encrypted,
        authority=None if ca_path is None else _authority(ca_path),
        token=_token(token_path),
        token_file=token_path,
        ca=ca_path,
    )


def _path(argument: str | os.PathLike[str] | None, variable: str) -> Path | None:
    path = argument or os.environ.get(variable)
    return Path(path) if path else None


def _address(url: str) -> tuple[str, int, bool]:
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    is_bare = parts.path in ("", "/") and not (parts.query or parts.fragment or parts.username)
    if parts.scheme not in SCHEMES or not parts.hostname or not is_bare:
        raise SettingsError(
            f"failed to read {url!r} as a coordinator's address: write http://HOST:PORT, or with"
            " TLS https://HOST:PORT"
        )
    is_encrypted = SCHEMES[parts.scheme]
    return parts.hostname, port or (443 if is_encrypted else 80), is_encrypted


def _token(path: Path | None) -> str | None:
    if path is not None:
        try:
            with path.open(encoding="utf-8") as file:
                _require_private(path, os.fstat(file.fileno()))
                text = file.read()
        except UnicodeDecodeError:
            raise SettingsError(f"failed to read token file {path}: it is not UTF-8") from None
        except OSError as error:
            raise SettingsError(f"failed to read token file {path}: {error.strerror}") from error
        return _select_token(text, f"token file {path}")
    text = os.environ.get(TOKENS_VARIABLE, "")
    return _select_token(text, TOKENS_VARIABLE) if text else None


def _require_private(path: Path, status: os.stat_result) -> None:
    """Refuses a token file that other users can read or write; the command line has the same rule.
    The group may have access only if the file belongs to another user."""
    if not hasattr(os, "geteuid"):
        return  # Windows has no such permission bits.
    is_own = status.st_uid == os.geteuid()
    refused_bits, permitted = (0o077, "600") if is_own else (0o007, "o=")
    if stat.S_ISREG(status.st_mode) and status.st_mode & refused_bits:
        raise SettingsError(
            f"failed to read token file {path}: its permissions, {status.st_mode & 0o777:04o}, let"
            f" other users access its tokens; restrict them with `chmod {permitted} {path}`"
        )


def _select_token(text: str, place: str) -> str:
    """Returns the token of the preferred role from the lines of a token file."""
    tokens: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) != 2 or words[0] not in ALL_ROLES or not _is_visible(words[1]):
            raise SettingsError(
                f"failed to read line {number} of {place}: write one `ROLE TOKEN` per line, the"
                " role being worker, operator or viewer, and the token visible ASCII characters"
            )
        tokens.setdefault(words[0], words[1])
    for role in ROLES:
        if role in tokens:
            return tokens[role]
    raise SettingsError(
        f"failed to find a token of role {' or '.join(ROLES)} in {place}: add a line `ROLE TOKEN`"
    )


def _is_visible(token: str) -> bool:
    return all("!" <= character <= "~" for character in token)


def _authority(path: Path) -> bytes:
    try:
        pem = path.read_bytes()
    except OSError as error:
        raise SettingsError(
            f"failed to read certificate authority {path}: {error.strerror}"
        ) from error
    try:
        ssl.create_default_context(cadata=pem.decode("ascii"))
    except (ssl.SSLError, UnicodeDecodeError, ValueError):
        # gRPC itself would only log an invalid authority.
        raise SettingsError(
            f"failed to use {path} as a certificate authority: it must hold certificates as PEM"
        ) from None
    return pem


def _is_this_machine(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).is_loopback
