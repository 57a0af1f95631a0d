"""Folders of LIBERO's files. Importing this module asks for no input and fetches or writes no
file."""

from libero.libero.paths import (
    config_file,
    get_assets_path,
    get_default_path_dict,
    get_libero_path,
    libero_config_path,
    set_libero_default_path,
)

__all__ = [
    "config_file", "get_assets_path", "get_default_path_dict", "get_libero_path",
    "libero_config_path", "set_libero_default_path",
]  # fmt: skip
