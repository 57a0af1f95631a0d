"""SmolVLA, as lerobot runs it.

Frames are resized with padding to 512 x 512 by the model itself. A chunk has 50
actions and one of them is executed: with the 50 or the 10 that configurations
suggest, the released checkpoint loses twenty points.
"""

from __future__ import annotations

from ..catalogue import Entry
from ..policy import Policy
from . import Options
from .flow import FlowPolicy
from .lerobot import LerobotModel

#: LIBERO-CTRL's protocol (`--n_action_steps 1`).
EXECUTE = 1


def load(entry: Entry, options: Options) -> Policy:
    """Loads the checkpoint; see `rollout_policies.adapters.load`."""
    model = LerobotModel.load(entry, options, kind="smolvla", n_action_steps=EXECUTE)
    return FlowPolicy(entry, model, execute=EXECUTE, max_batch=options.max_batch)
