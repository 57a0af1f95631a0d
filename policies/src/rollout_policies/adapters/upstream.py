"""Handling of third-party packages and files, shared by all adapters."""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from ..catalogue import Entry
from ..episode import Episode

#: Bytes per read of a file.
READ_BYTES = 1 << 20


class UpstreamMissing(ImportError):
    """The upstream package of a policy cannot be imported."""


class UnusableCheckpoint(ValueError):
    """The weights do not fit the policy, or files beside them are missing."""


class UnusableOption(ValueError):
    """A flag of the command line does not fit the policy or its checkpoint."""


class WrongSuite(ValueError):
    """An episode belongs to another suite than the weights."""


def require(module: str, entry: Entry) -> ModuleType:
    """Imports a module of the policy's upstream package.

    Raises UpstreamMissing, whose message says what to install."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise UpstreamMissing(
            f"failed to import {module}, the package of {entry.title} ({error});"
            f" install it: {entry.install}"
        ) from error


def require_suite(entry: Entry, served: str | None, episode: Episode) -> None:
    """Refuses an episode of a suite for which the weights were not trained.

    With such weights, the arm moves but every task fails, which looks like a poor policy."""
    if entry.per_suite and episode.suite != served:
        raise WrongSuite(
            f"this server has {entry.title}'s weights for {served}, and the episode is of"
            f" {episode.suite or 'no suite'}; route every suite to its own server"
        )


def digest(files: Iterable[Path]) -> str:
    """Returns SHA-256 over the names and contents of files, in hex. Servers with equal digests
    have the same weights."""
    total = hashlib.sha256()
    for path in sorted(files, key=lambda path: path.name):
        total.update(path.name.encode())
        with path.open("rb") as file:
            file_hash = hashlib.sha256()
            while data := file.read(READ_BYTES):
                file_hash.update(data)
        total.update(file_hash.digest())
    return total.hexdigest()


def precision(device: str, *networks: Any) -> dict[str, str]:
    """Returns the settings that determine a network's low-order digits: the
    data types of its parameters and the device type."""
    tensors = (tensor for network in networks for tensor in network.parameters())
    kinds = {str(tensor.dtype).removeprefix("torch.") for tensor in tensors}
    return {"precision": ", ".join(sorted(kinds)), "device": device.partition(":")[0]}


def seed_of(observation) -> int:
    """Returns a seed for a library's own generator, from the rollout's seed and
    the query index alone."""
    return int(observation.rng.integers(2**63))
