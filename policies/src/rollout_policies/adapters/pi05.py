"""π0.5, as lerobot runs it.

Frames are resized with padding to 224 x 224 by the model, and the state is
written into the prompt. openpi's own server needs no adapter: a gateway
speaks its protocol.

`lerobot/pi05_libero_base` is not fine-tuned and has no statistics of LIBERO: it
is refused. `lerobot/pi05-libero` is the one to serve.
"""

from __future__ import annotations

from ..catalogue import Entry
from ..policy import Policy
from . import Options
from .flow import FlowPolicy


def load(entry: Entry, options: Options) -> Policy:
    """Loads the checkpoint; see `rollout_policies.adapters.load`."""
    return FlowPolicy.load(entry, options, kind="pi05")
