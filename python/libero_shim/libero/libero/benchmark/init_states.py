"""Reads a task's initial states without PyTorch.

The files are written by `torch.save` from a NumPy array: a zip archive with a pickle. A
pickle can call any function that it names, and NumPy's own classes do not check shapes
and types: an array of objects over bytes of the file reads the bytes as pointers. So this
module only records the pickle's requests, and builds and checks the array from that record.
"""

from __future__ import annotations

import io
import os
import pickle
import pickletools
import zipfile
import zlib
from typing import Any

import numpy as np

# LIBERO's largest file has 117 kB.
_MOST_BYTES = 64 << 20
# An array takes some sixty operations. `worker` has the same limit.
_MOST_OPERATIONS = 256
# Python's unpickler allocates its memo as a list up to the highest index.
_MOST_MEMO_ENTRIES = 256


class _Tensors(Exception):
    """The file holds tensors instead of an array."""


class _Dtype:
    """A data type that a pickle requests."""

    def __init__(self, *arguments: Any) -> None:
        self.name = arguments[0] if arguments else None
        self.order: Any = "|"

    def __setstate__(self, state: Any) -> None:
        self.order = state[1]


class _Array:
    """An array that a pickle requests."""

    def __init__(self, *_arguments: Any) -> None:
        self.state: Any = None

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def build(self) -> Any:
        """Returns the array. Raises ValueError unless float64 [states, numbers] or [numbers]."""
        _, shape, dtype, is_fortran, content = self.state
        if not isinstance(dtype, _Dtype) or (dtype.name, dtype.order) != ("f8", "<"):
            raise ValueError("its numbers are not float64")
        if isinstance(content, _Encoded):
            content = content.text.encode("latin1")
        if not isinstance(content, bytes) or not isinstance(shape, tuple):
            raise ValueError("it is not a table of numbers")
        # LIBERO-Plus has files with a single state as a vector.
        if len(shape) not in (1, 2):
            raise ValueError(f"it has {len(shape)} dimensions")
        order = "F" if is_fortran else "C"
        return np.frombuffer(content, "<f8").reshape(shape, order=order).copy(order=order)


class _ArrayClass:
    """Replaces NumPy's class of arrays, which a pickle passes to `_reconstruct`."""


class _Encoded:
    """Bytes in a pickle of protocol 2, which holds them as a text to encode. The text is encoded
    only when needed, because a pickle may request the bytes of one text many times."""

    def __init__(self, text: str, encoding: str) -> None:
        if encoding != "latin1" or not isinstance(text, str):
            raise pickle.UnpicklingError(f"it requests the encoding {encoding}")
        self.text = text


_PERMITTED = {
    ("_codecs", "encode"): _Encoded,
    ("numpy", "dtype"): _Dtype,
    ("numpy", "ndarray"): _ArrayClass,
    ("numpy._core.multiarray", "_reconstruct"): _Array,
    ("numpy.core.multiarray", "_reconstruct"): _Array,
}


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if module.startswith("torch"):
            raise _Tensors
        if (module, name) not in _PERMITTED:
            raise pickle.UnpicklingError(f"it requests {module}.{name}")
        return _PERMITTED[module, name]


def _check(content: bytes) -> None:
    """Scans a pickle without executing it, since a few bytes can request a huge memo.

    Raises _Tensors; ValueError if it has more operations or memo entries than an array needs.
    """
    for count, (operation, argument, _) in enumerate(pickletools.genops(content), 1):
        if operation.name == "GLOBAL" and str(argument).startswith("torch"):
            raise _Tensors
        if count > _MOST_OPERATIONS:
            raise ValueError(f"its pickle has more than {_MOST_OPERATIONS} operations")
        writes_memo = operation.name in ("PUT", "BINPUT", "LONG_BINPUT")
        if writes_memo and not 0 <= int(argument) < _MOST_MEMO_ENTRIES:
            raise ValueError(f"its pickle uses memo entry {argument} of {_MOST_MEMO_ENTRIES}")


def _pickle_in(path: str | os.PathLike[str]) -> bytes:
    """Returns the pickle in a file."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        member = next(member for member in members if member.filename.endswith("/data.pkl"))
        # With other compression methods, a read decompresses whole blocks, whatever size is
        # requested.
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError("its pickle is neither stored nor deflated")
        with archive.open(member) as packed:
            content = packed.read(_MOST_BYTES + 1)
    if len(content) > _MOST_BYTES:
        raise ValueError(f"its pickle is larger than {_MOST_BYTES >> 20} MiB")
    return content


def load_init_states(path: str | os.PathLike[str]) -> Any:
    """Returns the states of a `.pruned_init` or `.init` file: a float64 array
    [states, numbers], or the numbers of one state.

    A file that holds tensors, as none of LIBERO's own files does, is read by PyTorch and gives
    tensors.

    Raises FileNotFoundError; ValueError if the file holds no states; ImportError if it holds
    tensors and PyTorch is not installed.
    """
    try:
        content = _pickle_in(path)
        _check(content)
        array = _Unpickler(io.BytesIO(content)).load()
        if not isinstance(array, _Array):
            raise ValueError("its pickle is no array")
        return array.build()
    except _Tensors:
        return _load_tensors(path)
    except FileNotFoundError:
        raise
    # Corrupt pickles and archives raise nearly any exception.
    except (
        zipfile.BadZipFile,
        zlib.error,
        StopIteration,
        pickle.UnpicklingError,
        ArithmeticError,
        AttributeError,
        EOFError,
        LookupError,
        MemoryError,
        NotImplementedError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:
        raise ValueError(
            f"{os.fspath(path)} holds no initial states ({str(error) or 'no pickle in it'}): "
            "fetch the file again"
        ) from error


def _load_tensors(path: str | os.PathLike[str]) -> Any:
    try:
        import torch
    except ImportError as error:
        raise ImportError(
            f"{os.fspath(path)} holds PyTorch tensors: install torch to read it"
        ) from error
    return torch.load(path, weights_only=True)
