"""Folders of LIBERO-Plus' task files."""

from __future__ import annotations

from libero.libero._family import Folders
from libero.libero.paths import get_assets_path
from liberoplus.liberoplus.files import folder

__all__ = ["get_assets_path", "get_default_path_dict", "get_libero_path", "set_libero_default_path"]

_folders = Folders("LIBERO-Plus", __file__, folder)
get_libero_path = _folders.get_libero_path
get_default_path_dict = _folders.get_default_path_dict
set_libero_default_path = _folders.set_libero_default_path
