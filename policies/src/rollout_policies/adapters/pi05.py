"""π0.5, as lerobot runs it.

The model resizes frames with padding to 224 x 224, and the state is written into the prompt.
openpi's own server needs no adapter: the gateway supports its protocol.

`lerobot/pi05_libero_base` is not fine-tuned and has no statistics of LIBERO, so it is refused.
Serve `lerobot/pi05-libero`."""

from __future__ import annotations

from ..catalogue import Entry
from ..policy import Policy
from . import Options
from .flow import FlowPolicy


def load(entry: Entry, options: Options) -> Policy:
    """Loads the checkpoint; see `rollout_policies.adapters.load`."""
    return FlowPolicy.load(entry, options, kind="pi05")
