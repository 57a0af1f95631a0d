"""SmolVLA, as lerobot runs it.

Frames are resized with padding to 512 x 512 by the model itself. A chunk has 50
actions; of the released checkpoint's, LIBERO-CTRL executes one: with 50 or 10 it
loses twenty points.
"""

from __future__ import annotations

from ..catalogue import Entry
from ..policy import Policy
from . import Options
from .flow import FlowPolicy


def load(entry: Entry, options: Options) -> Policy:
    """Loads the checkpoint; see `rollout_policies.adapters.load`."""
    return FlowPolicy.load(entry, options, kind="smolvla")
