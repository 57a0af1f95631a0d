"""Folders of LIBERO's and LIBERO-PRO's task files, and LIBERO's environments as module `envs`."""

from __future__ import annotations

import sys

from libero.libero import envs
from libero.libero._family import Folders
from libero.libero.paths import get_assets_path
from liberopro.liberopro.files import folder

__all__ = [
    "envs",
    "get_assets_path",
    "get_default_path_dict",
    "get_libero_path",
    "set_libero_default_path",
]

# The module of LIBERO's environments under a second name, so that the classes that it exports exist
# once. Its submodules have no second name.
sys.modules[f"{__name__}.envs"] = envs

_folders = Folders("LIBERO-PRO", __file__, folder)
get_libero_path = _folders.get_libero_path
get_default_path_dict = _folders.get_default_path_dict
set_libero_default_path = _folders.set_libero_default_path
