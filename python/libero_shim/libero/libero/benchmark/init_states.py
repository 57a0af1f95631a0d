"""Reads a task's initial states without PyTorch.

The files are written by `torch.save` from a NumPy array, and users' own from a tensor or a list of
either, too: a zip archive with a pickle. A pickle can call any function that it names, and NumPy's
own classes do not check shapes and types: an array of objects over bytes of the file reads the
bytes as pointers. So this module only records the pickle's requests, and builds and checks the
array from that record."""

from __future__ import annotations

import io
import os
import pickle
import pickletools
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

# LIBERO's largest file has 117 kB.
_MOST_BYTES = 64 << 20
# A list takes some 25 operations for each state. `worker` has the same limit.
_MOST_OPERATIONS = 8_192
# Python's unpickler allocates its memo as a list up to the highest index.
_MOST_MEMO_ENTRIES = _MOST_OPERATIONS
_TYPES = ("f8", "f4")


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
        """Returns the array. Raises ValueError unless floats [states, numbers] or [numbers]."""
        _, shape, dtype, is_fortran, content = self.state
        if not isinstance(dtype, _Dtype) or dtype.name not in _TYPES or dtype.order != "<":
            raise ValueError("its numbers are neither float64 nor float32")
        if isinstance(content, _Encoded):
            content = content.text.encode("latin1")
        if not isinstance(content, (bytes, bytearray)):
            raise ValueError("it is not a table of numbers")
        _check_shape(shape)
        order: Any = "F" if is_fortran else "C"
        return np.frombuffer(content, "<" + dtype.name).reshape(shape, order=order).copy(order)


def _from_buffer(content: Any, dtype: Any, shape: Any, order: Any) -> _Array:
    """Replaces NumPy's function that makes an array in protocol 5."""
    array = _Array()
    array.state = (1, shape, dtype, order == "F", content)
    return array


class _Tensor:
    """A tensor that a pickle requests."""

    def __init__(self, storage: Any, offset: Any, shape: Any, strides: Any, *_: Any) -> None:
        self.numbers, self.offset, self.shape, self.strides = storage, offset, shape, strides

    def build(self) -> Any:
        """Returns the tensor as an array. Raises ValueError as `_Array.build` does."""
        _check_shape(self.shape)
        _check_shape(self.strides)
        if not isinstance(self.numbers, np.ndarray) or len(self.shape) != len(self.strides):
            raise ValueError("it is not a table of numbers")
        index = np.full(self.shape, self.offset)
        for axis, stride in enumerate(self.strides):
            along = [-1 if other == axis else 1 for other in range(len(self.shape))]
            index += stride * np.arange(self.shape[axis]).reshape(along)
        return self.numbers[index]


def _check_shape(shape: Any) -> None:
    if not isinstance(shape, tuple) or not all(type(size) is int and size >= 0 for size in shape):
        raise ValueError("its shape is no tuple of sizes")
    # LIBERO-Plus has files with a single state as a vector.
    if len(shape) not in (1, 2):
        raise ValueError(f"it has {len(shape)} dimensions")
    if np.prod(shape, dtype=object) * 8 > _MOST_BYTES:
        raise ValueError(f"it has more than {_MOST_BYTES >> 20} MiB")


class _Hooks:
    """Replaces the empty dictionary of a tensor's hooks."""


class _ArrayClass:
    """Replaces NumPy's class of arrays, which a pickle passes to `_reconstruct`."""


class _Encoded:
    """Bytes in a pickle of protocol 2, which holds them as a text to encode. The text is encoded
    only when needed, because a pickle may request the bytes of one text many times."""

    def __init__(self, text: str, encoding: str) -> None:
        if encoding != "latin1" or not isinstance(text, str):
            raise pickle.UnpicklingError(f"it requests the encoding {encoding}")
        self.text = text


_PERMITTED: dict[tuple[str, str], Any] = {
    ("_codecs", "encode"): _Encoded,
    ("collections", "OrderedDict"): _Hooks,
    ("numpy", "dtype"): _Dtype,
    ("numpy", "ndarray"): _ArrayClass,
    ("numpy._core.multiarray", "_reconstruct"): _Array,
    ("numpy.core.multiarray", "_reconstruct"): _Array,
    ("numpy._core.numeric", "_frombuffer"): _from_buffer,
    ("numpy.core.numeric", "_frombuffer"): _from_buffer,
    ("torch", "DoubleStorage"): "<f8",
    ("torch", "FloatStorage"): "<f4",
    ("torch._utils", "_rebuild_tensor_v2"): _Tensor,
}


class _Unpickler(pickle.Unpickler):
    """Reads a pickle, and the storages of its tensors by `read`."""

    def __init__(self, content: bytes, read: Callable[[str], bytes]) -> None:
        super().__init__(io.BytesIO(content))
        self._read = read
        self._storages: dict[str, Any] = {}

    def persistent_load(self, pid: Any) -> Any:
        _, dtype, key, *_ = pid
        if dtype not in ("<f8", "<f4"):
            raise pickle.UnpicklingError("it requests a storage of other numbers")
        if key not in self._storages:
            self._storages[key] = np.frombuffer(self._read(key), dtype)
        return self._storages[key]

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _PERMITTED:
            raise pickle.UnpicklingError(f"it requests {module}.{name}")
        return _PERMITTED[module, name]


def _check(content: bytes) -> None:
    """Scans a pickle without executing it, since a few bytes can request a huge memo.

    Raises ValueError if it has more operations or memo entries than an array needs."""
    for count, (operation, argument, _) in enumerate(pickletools.genops(content), 1):
        if count > _MOST_OPERATIONS:
            raise ValueError(f"its pickle has more than {_MOST_OPERATIONS} operations")
        writes_memo = operation.name in ("PUT", "BINPUT", "LONG_BINPUT")
        if writes_memo and not 0 <= int(argument) < _MOST_MEMO_ENTRIES:
            raise ValueError(f"its pickle uses memo entry {argument} of {_MOST_MEMO_ENTRIES}")


def _states_in(archive: zipfile.ZipFile) -> Any:
    """Returns the states in an archive: an array, or a tensor if it holds tensors."""
    room = _MOST_BYTES

    def read(name: str) -> bytes:
        nonlocal room
        member = archive.getinfo(name)
        # With other compression methods, a read decompresses whole blocks, whatever size is
        # requested.
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError("its pickle is neither stored nor deflated")
        with archive.open(member) as packed:
            content = packed.read(room + 1)
        room -= len(content)
        if room < 0:
            raise ValueError(f"its pickle is larger than {_MOST_BYTES >> 20} MiB")
        return content

    name = next(name for name in archive.namelist() if name.endswith("/data.pkl"))
    content = read(name)
    _check(content)
    root = name.removesuffix("data.pkl")
    states = _Unpickler(content, lambda key: read(f"{root}data/{key}")).load()
    rows = states if isinstance(states, list) else [states]
    if not rows or not all(isinstance(row, (_Array, _Tensor)) for row in rows):
        raise ValueError("its pickle is no array")
    built = []
    for row in rows:
        built.append(row.build())
        # The rows of a list may share their data.
        if sum(array.nbytes for array in built) > _MOST_BYTES:
            raise ValueError(f"it has more than {_MOST_BYTES >> 20} MiB")
    array = np.concatenate([np.atleast_2d(row) for row in built]) if states is rows else built[0]
    if not np.isfinite(array).all():
        raise ValueError("it holds a number that is not finite")
    return _as_tensor(array) if isinstance(rows[0], _Tensor) else array


def load_init_states(path: str | os.PathLike[str]) -> Any:
    """Returns the states of a `.pruned_init` or `.init` file: a float64 array [states, numbers], or
    the numbers of one state.

    A file that holds tensors, as none of LIBERO's own files does, gives a tensor if PyTorch is
    installed.

    Raises FileNotFoundError; ValueError if the file holds no states."""
    with open(path, "rb") as file:
        if other := _other_file(file.read(64).lstrip()):
            raise ValueError(f"{os.fspath(path)} holds no initial states: {other}")
    try:
        with zipfile.ZipFile(path) as archive:
            return _states_in(archive)
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
            "save states with torch.save(numpy.array(states), file), or fetch the file again"
        ) from error


def _other_file(start: bytes) -> str | None:
    """Returns what a file is instead of states, if its start shows that."""
    if not start:
        return "it is empty; fetch or save it again"
    if start.startswith(b"<"):
        return "it is a web page; download the file that the page shows"
    if start.startswith(b"version https://git-lfs"):
        return "it is a pointer of Git LFS; fetch the file with `git lfs pull`"
    return None


def _as_tensor(array: Any) -> Any:
    try:
        import torch
    except ImportError:
        return array
    return torch.from_numpy(array)
