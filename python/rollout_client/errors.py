"""What can go wrong between a notebook and a coordinator, each with its remedy in the message."""

from __future__ import annotations


class CoordinatorError(Exception):
    """Any error of this package."""


class SettingsError(CoordinatorError, ValueError):
    """An argument or an environment variable cannot be used: a URL, a token file, a
    certificate authority, or a specification's file."""


class UnreachableError(CoordinatorError, ConnectionError):
    """No coordinator answers at the URL."""

    def __init__(self, url: str, found: str, remedy: str) -> None:
        super().__init__(f"failed to reach the coordinator at {url}: {found}; {remedy}")
        #: The coordinator's address, as given.
        self.url = url
        #: What is there in its place, in words.
        self.found = found
        #: What to do about it, in words.
        self.remedy = remedy


class AccessDeniedError(CoordinatorError, PermissionError):
    """The coordinator knows no such token, or its role may not do this."""


class NoSuchCampaignError(CoordinatorError, LookupError):
    """The coordinator has no campaign of this name. Of a renamed one, the message says the
    new name."""


class RefusedError(CoordinatorError):
    """The coordinator, or its program on this machine, would not do it. The message has its
    words, and nothing has changed."""


class ProgramError(CoordinatorError, FileNotFoundError):
    """The program `coordinator`, which computes reports, is not on this machine."""
