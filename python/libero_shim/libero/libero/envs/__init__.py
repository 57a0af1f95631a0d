"""LIBERO's environments."""

from typing import Any

from libero.libero.envs.bddl_base_domain import TASK_MAPPING
from libero.libero.envs.env_wrapper import (
    ControlEnv,
    DemoRenderEnv,
    OffScreenRenderEnv,
    SegmentationRenderEnv,
)
from libero.libero.envs.venv import DummyVectorEnv, SubprocVectorEnv

__all__ = [
    "TASK_MAPPING", "ControlEnv", "DemoRenderEnv", "DummyVectorEnv", "OffScreenRenderEnv",
    "SegmentationRenderEnv", "SubprocVectorEnv",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in ("OBJECTS_DICT", "MountedPanda", "OnTheGroundPanda"):
        raise ImportError(
            f"libero.libero.envs.{name} is not part of rollout-libero-shim: it describes a "
            "model for robosuite; install the original LIBERO in another environment for it"
        )
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
