"""Prepares the imports of RLinf's and LIBERO's files, which are run unmodified, in a process and
in those that it spawns: stand-ins for packages that these files import and never call here, and
the original that renders only at the end of each chunk.
"""

from __future__ import annotations

import functools
import importlib.abc
import importlib.machinery
import importlib.util
import logging
import os
import sys
import types
from typing import Any
from unittest.mock import MagicMock

import numpy as np

#: Imports for videos, data sets and training. Installed packages of these names take precedence.
_BESIDE = (
    "codetiming",
    "cv2",
    "draccus",
    "h5py",
    "hydra",
    "imageio",
    "matplotlib",
    "natsort",
    "pandas",
    "ray",
    "tensordict",
    "tensorflow",
    "tqdm",
    "transformers",
)
#: Set to "SETTLING:CHUNK" for an original that renders only the last step of each chunk.
LAST_OF_CHUNK = "ROLLOUT_BENCH_LAST_OF_CHUNK"


class _StandIns(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        if name.partition(".")[0] in _BESIDE:
            return importlib.machinery.ModuleSpec(name, self, is_package=True)
        return None

    def create_module(self, spec: Any) -> types.ModuleType:
        module = types.ModuleType(spec.name)
        module.__getattr__ = _attribute  # type: ignore[method-assign]
        return module

    def exec_module(self, module: types.ModuleType) -> None:
        pass


def _attribute(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    return MagicMock()


def prepare() -> None:
    """Makes the frameworks' files importable. Spawned processes call it, too."""
    # The original imports PyTorch, and calls nothing of it in these rollouts.
    if importlib.util.find_spec("torch") is None:
        sys.modules["torch"] = types.ModuleType("torch")
    sys.meta_path.append(_StandIns())
    # RLinf's own logger needs Ray.
    log = types.ModuleType("rlinf.utils.logging")
    log.get_logger = lambda *_: logging.getLogger("rlinf")  # type: ignore[attr-defined]
    sys.modules["rlinf.utils.logging"] = log
    if schedule := os.environ.get(LAST_OF_CHUNK):
        settling, chunk = map(int, schedule.split(":"))
        _render_last_of_chunk(settling, chunk)


def _render_last_of_chunk(settling: int, chunk: int) -> None:
    """Lets the original skip rendering except in the last settling step and the last step of each
    chunk. Other steps repeat the previous picture, so that observations keep their size.
    """
    from robosuite.utils import binding_utils

    from libero.libero.envs import env_wrapper

    count = 0
    draws = True
    last: dict[tuple[Any, ...], Any] = {}
    render, step = binding_utils.MjSim.render, env_wrapper.ControlEnv.step
    set_init_state = env_wrapper.ControlEnv.set_init_state

    @functools.wraps(render)
    def rendered(self: Any, *arguments: Any, **named: Any) -> Any:
        key = (arguments, tuple(sorted(named.items())))
        if draws or key not in last:
            last[key] = render(self, *arguments, **named)
        return last[key]

    @functools.wraps(step)
    def stepped(self: Any, action: np.ndarray) -> Any:
        nonlocal count, draws
        count += 1
        draws = count >= settling and (count - settling) % chunk == 0
        return step(self, action)

    @functools.wraps(set_init_state)
    def begun(self: Any, state: np.ndarray) -> Any:
        nonlocal count, draws
        count, draws = 0, False
        return set_init_state(self, state)

    binding_utils.MjSim.render = rendered
    env_wrapper.ControlEnv.step = stepped
    env_wrapper.ControlEnv.set_init_state = begun
