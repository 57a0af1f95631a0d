"""The policies of the LIBERO-CTRL paper.

A module imports its policy's upstream package only when the policy is served, and holds only the
details of that policy: its inputs, its prompt, the length of its chunks and the source of its
noise. Arithmetic on frames and actions is in `rollout_policies.processing`."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Mapping
from dataclasses import dataclass

from ..catalogue import SUITES, Entry, entry
from ..policy import Policy
from .fetch import naming_downloads
from .upstream import UnusableOption

#: The module of each policy in the catalogue.
MODULES = {
    "pi05": "flow", "openvla-oft": "openvla_oft", "univla": "univla", "smolvla": "flow",
    "vla-jepa": "vla_jepa", "predvla": "predvla", "minerva": "minerva",
}  # fmt: skip

#: Policies whose noise is drawn outside the network, so that each query of a batch gets its own.
BATCHING = ("pi05", "smolvla")
#: Policies whose checkpoints name their image slots.
WITH_SLOTS = ("pi05", "smolvla", "vla-jepa", "minerva")
#: Policies that the LIBERO-CTRL study evaluated differently from their authors.
WITH_STUDY = ("univla",)
EVALUATIONS = ("upstream", "study")

log = logging.getLogger("rollout_policies")


@dataclass(frozen=True)
class Options:
    """Command-line options for serving a policy."""

    #: Name on the hub or local path; None selects the catalogue's checkpoint.
    checkpoint: str | None = None
    #: The hub's branch, tag or commit; its main branch if None.
    revision: str | None = None
    #: Suite, for policies that have separate weights for every suite.
    suite: str | None = None
    #: Device name as in torch.
    device: str = "cuda"
    #: Largest number of queries in one forward pass, for policies that support batches.
    max_batch: int = 1
    #: Actions of a chunk that are executed; None takes LIBERO-CTRL's number for a checkpoint of
    #: the catalogue, else the checkpoint's own.
    execute: int | None = None
    #: Image slots by camera ("scene", "wrist"), if the slot names do not determine them.
    image_keys: Mapping[str, str] | None = None
    #: Evaluation protocol to follow: that of the policy's authors or LIBERO-CTRL's.
    evaluation: str = "upstream"


def load(name: str, options: Options) -> Policy:
    """Loads a policy, ready to be served. Raises UnusableOption, NoCheckpoint, UpstreamMissing,
    UnusableCheckpoint, or whatever the upstream package raises."""
    listed = entry(name)
    _require_options(listed, options)
    module = importlib.import_module(f"{__name__}.{MODULES[name]}")
    with naming_downloads(listed.downloads):
        return module.load(listed, options)


def _require_options(listed: Entry, options: Options) -> None:
    """Refuses options that no checkpoint of the policy supports."""
    if options.suite is not None and options.suite not in SUITES:
        raise UnusableOption(f"--suite must be one of {', '.join(SUITES)}, and is {options.suite}")
    if options.max_batch > 1 and listed.name not in BATCHING:
        raise UnusableOption(
            f"{listed.title} answers one query at a time; --max-batch is for"
            f" {' and '.join(BATCHING)}"
        )
    if options.image_keys and listed.name not in WITH_SLOTS:
        raise UnusableOption(
            f"{listed.title}'s images have no names; --image-keys is for {', '.join(WITH_SLOTS)}"
        )
    if options.evaluation != EVALUATIONS[0] and listed.name not in WITH_STUDY:
        raise UnusableOption(
            f"the study ran {listed.title} as its authors do; --evaluation is for"
            f" {', '.join(WITH_STUDY)}"
        )


def executed_actions(listed: Entry, options: Options, *, chunk: int, from_checkpoint: int) -> int:
    """Returns the number of executed actions of a chunk: the command line's, else LIBERO-CTRL's for
    the checkpoints of the catalogue, else `from_checkpoint`, the checkpoint's own. Raises
    UnusableOption for a number that does not fit the chunk."""
    protocol = listed.execute if listed.lists(options.checkpoint) else None
    candidates = (options.execute, protocol, from_checkpoint)
    number = next(number for number in candidates if number is not None)
    if not 1 <= number <= chunk:
        source = "--execute" if options.execute is not None else "the number of executed actions"
        answers = "1 action" if chunk == 1 else f"chunks of {chunk} actions"
        raise UnusableOption(
            f"{source} is {number}, and {listed.title} answers {answers} here; it must be"
            f" {'1' if chunk == 1 else f'from 1 to {chunk}'}"
        )
    if options.execute is None and listed.execute not in (None, number):
        log.warning(
            "executing %d actions of every chunk, the checkpoint's number; LIBERO-CTRL executes %d"
            " with the listed checkpoint of %s (--execute N sets another number)",
            number,
            listed.execute,
            listed.title,
        )
    return number
