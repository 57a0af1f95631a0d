"""The policies that this package can serve, as listed in checkpoints.toml."""

from __future__ import annotations

import importlib.resources
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


#: Suites for which weights are trained.
SUITES = ("libero_spatial", "libero_object", "libero_goal", "libero_10")


class NoCheckpoint(ValueError):
    """The suite that selects the checkpoint is missing or unknown, or the checkpoint's name is
    neither that of a local file or folder nor of a repository on the hub."""


@dataclass(frozen=True)
class Entry:
    """One policy of the catalogue."""

    #: Name on the command line and in the policy's description.
    name: str
    #: Name in its paper.
    title: str
    #: Number of parameters according to its publisher.
    parameters: int
    #: Checkpoint id; one per suite if every suite has its own.
    checkpoint: str | Mapping[str, str]
    #: How to install the upstream package.
    install: str
    #: Number of actions of every chunk that LIBERO-CTRL's protocol executes with these checkpoints;
    #: None if the policy leaves no choice.
    execute: int | None = None
    #: Downloads besides the checkpoint: a description by name.
    downloads: Mapping[str, str] = field(default_factory=dict)

    @property
    def per_suite(self) -> bool:
        """True if every suite has its own weights, and thus its own server."""
        return not isinstance(self.checkpoint, str)

    def lists(self, checkpoint: str | None) -> bool:
        """Returns True if the command line's checkpoint is one of this entry's, or is None, which
        selects the entry's."""
        if isinstance(self.checkpoint, str):
            return checkpoint in (None, self.checkpoint)
        return checkpoint is None or checkpoint in self.checkpoint.values()

    def checkpoint_for(self, suite: str | None) -> str:
        """Returns the checkpoint's id for a suite such as "libero_goal". Raises NoCheckpoint if a
        suite is needed and is missing or unknown."""
        if isinstance(self.checkpoint, str):
            return self.checkpoint
        if suite is None or suite not in self.checkpoint:
            raise NoCheckpoint(
                f"{self.title} has separate weights for every suite: --suite must be one of"
                f" {', '.join(self.checkpoint)}, and is {suite or 'missing'}"
            )
        return self.checkpoint[suite]


def entries() -> dict[str, Entry]:
    """Returns all policies by name, in the order of the paper."""
    text = importlib.resources.files(__package__).joinpath("checkpoints.toml").read_text("utf-8")
    return {name: Entry(name=name, **fields) for name, fields in tomllib.loads(text).items()}


def entry(name: str) -> Entry:
    return entries()[name]
