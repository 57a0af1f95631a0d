"""What checkpoints.toml says of the policies that this package can serve."""

from __future__ import annotations

import importlib.resources
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


#: The suites that weights are trained for.
SUITES = ("libero_spatial", "libero_object", "libero_goal", "libero_10")


class UnknownPolicy(ValueError):
    """No adapter has this name."""


class NoCheckpoint(ValueError):
    """Which weights to serve was not said."""


@dataclass(frozen=True)
class Entry:
    """One policy of the catalogue."""

    #: As the command line and the policy's description call it.
    name: str
    #: As its paper calls it.
    title: str
    #: As its publisher counts them.
    parameters: int
    #: Checkpoint id; by suite where every suite has its own.
    checkpoint: str | Mapping[str, str]
    #: The upstream package's top module, and how to install it.
    module: str
    install: str
    #: Of every chunk of these checkpoints, how many actions LIBERO-CTRL's protocol
    #: executes; None where the policy leaves no choice.
    execute: int | None = None
    #: What is downloaded besides the checkpoint, by name, and what it is.
    downloads: Mapping[str, str] = field(default_factory=dict)

    @property
    def per_suite(self) -> bool:
        """Whether every suite has its own weights, and so its own server."""
        return not isinstance(self.checkpoint, str)

    def lists(self, checkpoint: str | None) -> bool:
        """Whether a checkpoint of the command line is one of these."""
        if isinstance(self.checkpoint, str):
            return checkpoint in (None, self.checkpoint)
        return checkpoint is None or checkpoint in self.checkpoint.values()

    def checkpoint_for(self, suite: str | None) -> str:
        """The checkpoint's id for a suite such as "libero_goal".

        Raises NoCheckpoint where a suite is needed and is missing or unknown.
        """
        if isinstance(self.checkpoint, str):
            return self.checkpoint
        if suite is None or suite not in self.checkpoint:
            raise NoCheckpoint(
                f"{self.title} has other weights for every suite: --suite must be one of"
                f" {', '.join(self.checkpoint)}, and is {suite or 'missing'}"
            )
        return self.checkpoint[suite]


def entries() -> dict[str, Entry]:
    """All policies by name, in the paper's order of fame."""
    text = importlib.resources.files(__package__).joinpath("checkpoints.toml").read_text("utf-8")
    return {name: Entry(name=name, **fields) for name, fields in tomllib.loads(text).items()}


def entry(name: str) -> Entry:
    """One policy. Raises UnknownPolicy, naming those that there are."""
    known = entries()
    if name not in known:
        raise UnknownPolicy(f"there is no adapter {name!r}; there are: {', '.join(known)}")
    return known[name]
