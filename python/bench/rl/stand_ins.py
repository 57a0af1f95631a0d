"""Prepares a process, and those that it spawns, to import RLinf's and LIBERO's unmodified files:
replaces packages that these files import and do not call here, and, if the environment variable
`ROLLOUT_BENCH_LAST_OF_CHUNK` is set, makes the original LIBERO render only at the end of each
chunk."""

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

#: Replaced packages, for videos, data sets and training. Installed packages of these names take
#: precedence.
_REPLACED = (
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
#: Environment variable that makes the original render only the last step of each chunk. Its value
#: is "SETTLING:CHUNK": the numbers of settling steps and of steps in a chunk.
LAST_OF_CHUNK = "ROLLOUT_BENCH_LAST_OF_CHUNK"


class _StandIns(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        if name.partition(".")[0] in _REPLACED:
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
    """Makes the frameworks' files importable. A program whose spawned processes need this calls it
    when it is imported."""
    # The original imports PyTorch, and does not call it in these rollouts.
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
    """Makes the original render only in the last settling step and the last step of each chunk,
    once an initial state was set and each camera has a picture. Observations of the other steps
    hold the last rendered picture, so that they keep their size."""
    from robosuite.utils import binding_utils

    from libero.libero.envs import env_wrapper

    count = 0
    is_rendered = True
    last_pictures: dict[tuple[Any, ...], Any] = {}
    render, step = binding_utils.MjSim.render, env_wrapper.ControlEnv.step
    set_init_state = env_wrapper.ControlEnv.set_init_state

    @functools.wraps(render)
    def render_or_repeat(self: Any, *arguments: Any, **named: Any) -> Any:
        key = (arguments, tuple(sorted(named.items())))
        if is_rendered or key not in last_pictures:
            last_pictures[key] = render(self, *arguments, **named)
        return last_pictures[key]

    @functools.wraps(step)
    def counted_step(self: Any, action: np.ndarray) -> Any:
        nonlocal count, is_rendered
        count += 1
        is_rendered = count >= settling and (count - settling) % chunk == 0
        return step(self, action)

    @functools.wraps(set_init_state)
    def set_init_state_and_count(self: Any, state: np.ndarray) -> Any:
        nonlocal count, is_rendered
        count, is_rendered = 0, False
        return set_init_state(self, state)

    binding_utils.MjSim.render = render_or_repeat
    env_wrapper.ControlEnv.step = counted_step
    env_wrapper.ControlEnv.set_init_state = set_init_state_and_count
