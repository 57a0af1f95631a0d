"""Compiled scenes, one per task, asset pack and look in a process, shared by all
environments of the task. Recent scenes outlive their environments, so that frameworks
that close and create an environment at every reset do not compile them again."""

from __future__ import annotations

import os
import threading
import warnings
import weakref
from collections import OrderedDict
from collections.abc import Hashable
from os import PathLike

from rollout_libero import files
from rollout_libero._library import native
from rollout_libero.tasks import Task

_Key = tuple[Hashable, ...]
_scenes: weakref.WeakValueDictionary[_Key, native.Scene] = weakref.WeakValueDictionary()
_recent: OrderedDict[_Key, native.Scene] = OrderedDict()
MAX_RECENT = 10
"""Number of scenes kept without an environment: enough for the tasks of a suite."""
_lock = threading.Lock()
_compiling: dict[_Key, threading.Lock] = {}
MAX_NAMES = 5
"""Number of files of a pack that a warning names."""


def scene_of_task(task: Task, assets: str | PathLike[str] | None, look: str | None) -> native.Scene:
    """Returns the compiled scene of a task, with its initial states.

    Raises:
        FileNotFoundError: if files are missing.
        ValueError: if there is no such look."""
    init = files.sources() / "libero" / "init_files" / task.suite / f"{task.file}.pruned_init"
    return scene(str(files.bddl_file(task)), assets, look, init_file=str(init))


def scene(
    bddl_file: str,
    assets: str | PathLike[str] | None,
    look: str | None,
    *,
    init_file: str | None = None,
) -> native.Scene:
    """Returns the compiled scene of a BDDL file. With the pack ``libero``, files that the scene
    needs are fetched if they are missing.

    Raises:
        FileNotFoundError: if files are missing.
        ValueError: if there is no such look."""
    sources, pack, look = str(files.sources()), files.assets(assets), files.look(look)
    key = (_version(bddl_file), pack, look, init_file and _version(init_file))
    # Compiling takes a second; two threads that need the same scene wait for one compilation.
    with _lock:
        compiling = _compiling.setdefault(key, threading.Lock())
    with compiling:
        compiled = _scenes.get(key)
        if compiled is None:
            if pack == files.LIBERO:
                native.fetch_assets(sources, [bddl_file])
            compiled = native.Scene(
                bddl_file, assets=pack, sources=sources, look=look, init_file=init_file
            )
            _scenes[key] = compiled
            if compiled.pack == "custom":
                warnings.warn(
                    f"the asset pack {pack} is not LIBERO's: "
                    f"{_describe_differences(compiled.pack_differences)}",
                    stacklevel=2,
                )
    _keep_recent(key, compiled)
    return compiled


def _describe_differences(differing: list[str]) -> str:
    """Describes how a pack differs from LIBERO's. The list is empty if the pack has none of
    LIBERO's files."""
    count = len(differing)
    if not count:
        return "it has none of LIBERO's files"
    names = ", ".join(differing[:MAX_NAMES])
    link = ", among them" if count > MAX_NAMES else ":"
    return f"{count} of LIBERO's files differ{link} {names}"


def _version(file: str) -> Hashable:
    """Returns a file's path, time and size, so that a changed file gives another scene; only the
    path if the file is missing."""
    try:
        status = os.stat(file)
    except OSError:
        return file
    return file, status.st_mtime_ns, status.st_size


def _keep_recent(key: _Key, compiled: native.Scene) -> None:
    with _lock:
        _recent[key] = compiled
        _recent.move_to_end(key)
        while len(_recent) > MAX_RECENT:
            _recent.popitem(last=False)
