"""Reading a task's initial states without PyTorch.

The files are what `torch.save` makes of a NumPy array: a zip archive with a pickle.
Only what such a pickle needs is let in, so that a file cannot run code.
"""

from __future__ import annotations

import io
import os
import pickle
import zipfile
from typing import Any

import numpy as np

_LETS_IN = {
    ("_codecs", "encode"),
    ("numpy", "dtype"),
    ("numpy", "ndarray"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy.core.multiarray", "_reconstruct"),
}


class _Tensors(Exception):
    """The file holds tensors, not an array."""


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if module.startswith("torch"):
            raise _Tensors
        if (module, name) not in _LETS_IN:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}")
        if name == "_reconstruct":
            # NumPy 2 has it elsewhere, and warns about the old place.
            return np.zeros(0).__reduce__()[0]
        return super().find_class(module, name)


def load_init_states(path: str | os.PathLike[str]) -> Any:
    """The states of a `.pruned_init` or `.init` file: a float64 array [states, numbers].

    A file with tensors in it, which LIBERO's own do not have, is read by PyTorch and
    gives tensors.

    Raises FileNotFoundError; ValueError if it is no such file; ImportError if it needs
    PyTorch and there is none.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            member = next(name for name in archive.namelist() if name.endswith("/data.pkl"))
            states = _Unpickler(io.BytesIO(archive.read(member))).load()
    except _Tensors:
        return _load_tensors(path)
    except (
        zipfile.BadZipFile,
        StopIteration,
        pickle.UnpicklingError,
        EOFError,
    ) as error:
        raise ValueError(
            f"{os.fspath(path)} holds no initial states ({error or 'no pickle in it'}): "
            "fetch the file again"
        ) from error
    return states


def _load_tensors(path: str | os.PathLike[str]) -> Any:
    try:
        import torch
    except ImportError as error:
        raise ImportError(
            f"{os.fspath(path)} holds PyTorch tensors: install torch to read it"
        ) from error
    return torch.load(path, weights_only=True)
