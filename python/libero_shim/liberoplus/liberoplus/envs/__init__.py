"""LIBERO-Plus' environments. All modules but `env_wrapper` are LIBERO's own."""

import sys

from libero.libero.envs import bddl_base_domain, bddl_utils, venv
from libero.libero.envs.venv import DummyVectorEnv, SubprocVectorEnv
from liberoplus.liberoplus.envs.env_wrapper import (
    TASK_MAPPING,
    ControlEnv,
    DemoRenderEnv,
    OffScreenRenderEnv,
    SegmentationRenderEnv,
)

__all__ = [
    "TASK_MAPPING", "ControlEnv", "DemoRenderEnv", "DummyVectorEnv", "OffScreenRenderEnv",
    "SegmentationRenderEnv", "SubprocVectorEnv",
]  # fmt: skip

for _module in (bddl_base_domain, bddl_utils, venv):
    sys.modules[f"{__name__}.{_module.__name__.rpartition('.')[2]}"] = _module
