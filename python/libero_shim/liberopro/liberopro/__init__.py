"""Folders of LIBERO's and LIBERO-PRO's task files, and LIBERO's environments below them."""

from __future__ import annotations

import os
import sys

from libero.libero import envs
from libero.libero import paths as _libero
from libero.libero.paths import get_assets_path
from liberopro.liberopro.files import folder

__all__ = [
    "envs",
    "get_assets_path",
    "get_default_path_dict",
    "get_libero_path",
    "set_libero_default_path",
]

# The same modules as LIBERO's environments, so that each class exists once.
sys.modules[f"{__name__}.envs"] = envs

#: Programs compare it with `benchmark_root`, as in `libero.libero`.
_PACKAGE = os.path.dirname(os.path.abspath(__file__))


def get_libero_path(query_key: str) -> str:
    """Returns the folder of `benchmark_root`, `bddl_files`, `init_states`, `datasets` or `assets`.
    Task files are fetched at first use.

    Raises KeyError for another key, FileNotFoundError if files cannot be fetched.
    """
    if query_key == "benchmark_root":
        return _PACKAGE
    if query_key == "bddl_files":
        return str(folder() / "bddl_files")
    if query_key == "init_states":
        return str(folder() / "init_files")
    return _libero.get_libero_path(query_key)


def get_default_path_dict(custom_location: str | None = None) -> dict[str, str]:
    """Returns the folder of each key. Raises ValueError for a custom location."""
    set_libero_default_path(custom_location)
    keys = ("benchmark_root", "bddl_files", "init_states", "datasets")
    return {key: get_libero_path(key) for key in keys} | {"assets": get_assets_path()}


def set_libero_default_path(custom_location: str | None = None) -> None:
    """Accepts the folder of this package, which is the default, and nothing else.

    Raises ValueError.
    """
    if custom_location is not None and os.path.abspath(custom_location) != _PACKAGE:
        raise ValueError(
            f"LIBERO-PRO's files lie where they were fetched, not in {custom_location}: set "
            "ROLLOUT_SOURCES to another folder for them"
        )
