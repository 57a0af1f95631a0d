"""Errors of calls to a coordinator. Each message includes the remedy."""

from __future__ import annotations


class CoordinatorError(Exception):
    """Base class of this package's errors."""


class SettingsError(CoordinatorError, ValueError):
    """An argument or an environment variable cannot be used: a URL, a token file, a
    certificate authority, or a specification's file."""


class UnreachableError(CoordinatorError, ConnectionError):
    """A call got no answer from a coordinator at the URL."""

    def __init__(self, url: str, found: str, remedy: str) -> None:
        super().__init__(f"failed to reach the coordinator at {url}: {found}; {remedy}")
        #: The coordinator's address, as given.
        self.url = url
        #: Description of the server that was found at the URL, or of the failed connection.
        self.found = found
        #: Description of the remedy.
        self.remedy = remedy


class AccessDeniedError(CoordinatorError, PermissionError):
    """The coordinator does not know the token, or the token's role does not permit the call."""


class NoSuchCampaignError(CoordinatorError, LookupError):
    """The coordinator has no campaign of this name. If it was renamed, the
    message gives the new name."""


class RefusedError(CoordinatorError):
    """The coordinator, or its program on this machine, refused a request and changed nothing. The
    message is that of the coordinator or the program."""


class ProgramError(CoordinatorError, FileNotFoundError):
    """The program `coordinator`, which computes reports, is not on this machine."""
