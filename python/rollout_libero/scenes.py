"""Compiled scenes: one of a task and an asset pack in a process, shared by all of its
environments."""

from __future__ import annotations

import threading
import warnings
import weakref
from os import PathLike

from rollout_libero import files
from rollout_libero._library import native
from rollout_libero.tasks import Task

_scenes: weakref.WeakValueDictionary[tuple[str, str, str], native.Scene] = (
    weakref.WeakValueDictionary()
)
_lock = threading.Lock()
_compiling: dict[tuple[str, str, str], threading.Lock] = {}
MAX_NAMED = 5
"""Files of a pack that a warning names."""


def scene_of_task(task: Task, assets: str | PathLike[str] | None) -> native.Scene:
    """The compiled scene of a task with its initial states.

    Raises:
        FileNotFoundError: if files are missing.
    """
    init = files.sources() / "libero" / "init_files" / task.suite / f"{task.file}.pruned_init"
    return scene(str(files.bddl_file(task)), assets, init_file=str(init))


def scene(
    bddl_file: str, assets: str | PathLike[str] | None, *, init_file: str | None = None
) -> native.Scene:
    """The compiled scene of a BDDL file. Of the pack ``libero``, files that it needs and that
    are not there are fetched.

    Raises:
        FileNotFoundError: if files are missing.
    """
    sources, pack = str(files.sources()), files.assets(assets)
    key = (bddl_file, pack, init_file or "")
    # Compiling takes a second; two threads that want the same wait for one.
    with _lock:
        compiling = _compiling.setdefault(key, threading.Lock())
    with compiling:
        found = _scenes.get(key)
        if found is None:
            if pack == files.LIBERO:
                native.fetch_assets(sources, [bddl_file])
            found = native.Scene(bddl_file, assets=pack, sources=sources, init_file=init_file)
            _scenes[key] = found
            if found.pack == "custom":
                differing = ", ".join(found.pack_differences[:MAX_NAMED]) or "all files"
                warnings.warn(
                    f"the asset pack {pack} is not LIBERO's; {len(found.pack_differences)} of "
                    f"LIBERO's files differ: {differing}",
                    stacklevel=2,
                )
        return found
