"""Folders of packages beside `libero` whose task files are fetched: LIBERO-PRO and LIBERO-Plus."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from libero.libero import paths
from rollout_libero import files

#: Folders of a package's fetched task files, by key of `get_libero_path`.
_FOLDERS = {"bddl_files": "bddl_files", "init_states": "init_files"}


class Folders:
    """The functions of one package that return folders, as in LIBERO's package. `package` is the
    path of a file in the folder `benchmark_root`; `fetched` returns the folder of the task files,
    and fetches them if they are missing."""

    def __init__(self, benchmark: str, package: str, fetched: Callable[[], Path]) -> None:
        self._benchmark = benchmark
        self._package = os.path.dirname(os.path.abspath(package))
        self._fetched = fetched

    def get_libero_path(self, query_key: str) -> str:
        """Returns the folder of `benchmark_root`, `bddl_files`, `init_states`, `datasets` or
        `assets`. Task files are fetched at first use. Raises KeyError for another key,
        FileNotFoundError if files cannot be fetched."""
        if query_key == "benchmark_root":
            return self._package
        if query_key in _FOLDERS:
            return str(self._fetched() / _FOLDERS[query_key])
        return paths.get_libero_path(query_key)

    def get_default_path_dict(self, custom_location: str | None = None) -> dict[str, str]:
        """Returns the folder of each key. Raises ValueError for any location but the default."""
        self.set_libero_default_path(custom_location)
        keys = ("benchmark_root", "bddl_files", "init_states", "datasets")
        folders = {key: self.get_libero_path(key) for key in keys}
        return {**folders, "assets": paths.get_assets_path()}

    def set_libero_default_path(self, custom_location: str | None = None) -> None:
        """Accepts no folder but that of this package, which is the default. Raises ValueError."""
        if custom_location is not None and os.path.abspath(custom_location) != self._package:
            raise ValueError(
                f"{self._benchmark}'s files lie where they were fetched, not in {custom_location}: "
                "set ROLLOUT_SOURCES to another folder for them"
            )


def link_suite(unpacked: Path, suite: str) -> None:
    """Links the BDDL files and initial states of one of LIBERO's suites into the folder of unpacked
    task files."""
    for kind in _FOLDERS.values():
        (unpacked / kind / suite).symlink_to(Path("../../libero") / kind / suite)


def libero_suite_names() -> list[str]:
    """Returns the suites that LIBERO has BDDL files of."""
    return [folder.name for folder in (files.sources() / "libero" / "bddl_files").iterdir()]
