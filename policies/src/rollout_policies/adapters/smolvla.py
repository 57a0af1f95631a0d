"""SmolVLA, as lerobot runs it.

The model resizes frames with padding to 512 x 512. A chunk has 50 actions. With the released
checkpoint, LIBERO-CTRL executes one of them: executing 50 or 10 lowers the success rate by twenty
points."""

from __future__ import annotations

from ..catalogue import Entry
from ..policy import Policy
from . import Options
from .flow import FlowPolicy


def load(entry: Entry, options: Options) -> Policy:
    """Loads the checkpoint; see `rollout_policies.adapters.load`."""
    return FlowPolicy.load(entry, options, kind="smolvla")
