"""The policies of the LIBERO-CTRL paper, each in its own module.

A module loads its policy's upstream package only when it is told to serve, and
holds nothing but what is particular to that policy: what it sees, what its
prompt says, how long its chunks are and where its noise comes from. Arithmetic
on frames and actions is in `rollout_policies.processing`.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass

from ..catalogue import entry
from ..policy import Policy

#: Module of each policy in the catalogue.
MODULES = {
    "pi05": "pi05",
    "openvla-oft": "openvla_oft",
    "univla": "univla",
    "smolvla": "smolvla",
    "vla-jepa": "vla_jepa",
    "predvla": "predvla",
    "minerva": "minerva",
}

#: Those that draw their noise outside the network, so that it can be given row
#: by row to a batch.
BATCHING = ("pi05", "smolvla")


class NoBatches(ValueError):
    """The policy answers one query at a time."""


@dataclass(frozen=True)
class Options:
    """What the command line may say about serving a policy."""

    #: A hub's id or a local path; the catalogue's own if None.
    checkpoint: str | None = None
    #: For policies with other weights for every suite.
    suite: str | None = None
    #: As torch names it.
    device: str = "cuda"
    #: Queries answered in one forward pass, where the policy can.
    max_batch: int = 1


def load(name: str, options: Options) -> Policy:
    """Loads a policy, ready to be served.

    Raises UnknownPolicy, NoBatches, NoCheckpoint, UpstreamMissing,
    UnusableCheckpoint, or whatever the upstream package raises.
    """
    listed = entry(name)
    if options.max_batch > 1 and name not in BATCHING:
        raise NoBatches(
            f"{listed.title} answers one query at a time; --max-batch is for"
            f" {' and '.join(BATCHING)}"
        )
    module = importlib.import_module(f"{__name__}.{MODULES[name]}")
    return module.load(listed, options)
