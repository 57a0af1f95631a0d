"""Loads the extension so that it uses its own MuJoCo.

The ``mujoco`` package exports its library's symbols to the whole process. If that library has
another version and was imported first, the extension would call it, and its physics differs from
the benchmark's. The extension therefore resolves symbols in its own libraries first."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any

MUJOCO = "3.3.7"


def _load() -> Any:
    own_symbols_first = getattr(os, "RTLD_DEEPBIND", 0)
    previous_flags = sys.getdlopenflags()
    sys.setdlopenflags(os.RTLD_NOW | os.RTLD_LOCAL | own_symbols_first)
    try:
        from rollout_libero import _native
    finally:
        sys.setdlopenflags(previous_flags)
    if _native.mujoco_version() != MUJOCO:
        raise ImportError(
            f"failed to load MuJoCo {MUJOCO}: this process has {_native.mujoco_version()} in its "
            "place; import rollout_libero before mujoco"
        )
    return _native


if TYPE_CHECKING:
    from rollout_libero import _native as native
else:
    native = _load()
