"""Folders of task files, initial states, demonstrations and assets."""

from __future__ import annotations

import os
from pathlib import Path

import yaml

from rollout_libero import files

#: Folder of the optional configuration file.
libero_config_path = os.environ.get("LIBERO_CONFIG_PATH", os.path.expanduser("~/.libero"))
#: The optional configuration file: a folder for each key of `get_default_path_dict`.
config_file = os.path.join(libero_config_path, "config.yaml")

_KEYS = ("benchmark_root", "bddl_files", "init_states", "datasets", "assets")
#: The folder of `libero.libero`, which holds LIBERO's files. Programs compare it with
#: `benchmark_root` to detect the configuration of another installation.
_PACKAGE = os.path.dirname(os.path.abspath(__file__))


def get_libero_path(query_key: str) -> str:
    """Returns the folder of `benchmark_root`, `bddl_files`, `init_states`, `datasets` or `assets`.

    The folder in the configuration file is used if it contains files, so that a configuration file
    of a removed installation does no harm. Otherwise the default folder is used, whose files are
    fetched at first use.

    Raises KeyError for another key that the configuration file lacks, FileNotFoundError if the
    files are unavailable, ValueError if the configuration file is not YAML."""
    configured = _configured()
    if query_key not in _KEYS and query_key not in configured:
        raise KeyError(
            f"LIBERO has no folder `{query_key}`: ask for one of {', '.join(_KEYS)}, "
            f"or name it in {config_file}"
        )
    folder = configured.get(query_key)
    if folder is not None and (query_key not in _KEYS or _is_usable(query_key, folder)):
        return folder
    if query_key == "assets":
        return files.assets(None)
    if query_key == "benchmark_root":
        return _PACKAGE
    return _folders(_default_root())[query_key]


def get_default_path_dict(custom_location: str | None = None) -> dict[str, str]:
    """Returns the folders below `custom_location`; without it, the folders of the fetched files."""
    if custom_location is None or _is_this_package(custom_location):
        return {**_folders(_default_root()), "benchmark_root": _PACKAGE}
    return _folders(custom_location)


def set_libero_default_path(custom_location: str | None = None) -> None:
    """Writes a configuration file for LIBERO's files in `custom_location`. If that is None or this
    package's folder, removes the configuration file, so that the defaults apply again.

    Raises FileNotFoundError if the folder has no `bddl_files`, because `get_libero_path` would
    ignore such a folder."""
    if custom_location is None or _is_this_package(custom_location):
        Path(config_file).unlink(missing_ok=True)
        return
    folders = _folders(os.path.abspath(custom_location))
    if not _has_files(folders["bddl_files"]):
        raise FileNotFoundError(
            f"there are no task files in {folders['bddl_files']}: "
            "name the folder that holds LIBERO's bddl_files"
        )
    os.makedirs(libero_config_path, exist_ok=True)
    with open(config_file, "w", encoding="utf-8") as file:
        yaml.safe_dump(folders, file)


def get_assets_path() -> str:
    """Returns the asset pack: `$ROLLOUT_ASSETS`, the configuration file's, or the fetched one.

    Raises FileNotFoundError, with the remedy, if there is none."""
    if os.environ.get("ROLLOUT_ASSETS"):
        return files.assets(None)
    return get_libero_path("assets")


def _is_this_package(folder: str) -> bool:
    return os.path.abspath(folder) == _PACKAGE


def _default_root() -> str:
    return str(files.sources() / "libero")


def _folders(root: str) -> dict[str, str]:
    return {
        "benchmark_root": root,
        "bddl_files": os.path.join(root, "bddl_files"),
        "init_states": os.path.join(root, "init_files"),
        "datasets": os.path.join(os.path.dirname(root), "datasets"),
        "assets": os.path.join(root, "assets"),
    }


def _configured() -> dict[str, str]:
    try:
        with open(config_file, encoding="utf-8") as file:
            config = yaml.safe_load(file)
    except FileNotFoundError:
        return {}
    except yaml.YAMLError as error:
        raise ValueError(f"{config_file} is not YAML ({error}): correct or remove it") from error
    if not isinstance(config, dict):
        return {}
    return {str(key): str(folder) for key, folder in config.items() if folder is not None}


def _is_usable(key: str, folder: str) -> bool:
    """Returns True if a folder contains files. For `benchmark_root`, checks `bddl_files` below it,
    because a package's own folder is never empty."""
    if key == "benchmark_root":
        return _has_files(os.path.join(folder, "bddl_files"))
    return _has_files(folder)


def _has_files(folder: str) -> bool:
    try:
        with os.scandir(folder) as entries:
            return next(entries, None) is not None
    except OSError:
        return False
