"""Transfer of large arrays from a process to its parent through shared memory.

A frame of 256 × 256 pixels is three times as large as a pipe's buffer, so that sender and receiver
of a frame would wait for each other several times. Messages still go through the pipe of
`multiprocessing`; they hold positions in the shared memory in place of large arrays, and the parent
copies the arrays from there when it unpickles a message."""

from __future__ import annotations

import io
import itertools
import mmap
import os
import weakref
from multiprocessing import reduction
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Size of the memory, bytes. It occupies only the pages that are written.
SIZE = 16 << 20
#: Size, bytes, below which an array stays in the message.
_SMALL = 16 << 10
#: Alignment of arrays, bytes.
_ALIGNED = 64

_numbers = itertools.count()
_shared: weakref.WeakValueDictionary[int, SharedMemory] = weakref.WeakValueDictionary()


class SharedMemory:
    """Memory shared with a process that is started with it as an argument.

    It holds the arrays of one message at a time: the parent unpickles a message before it sends the
    command that causes the next message."""

    def __init__(self) -> None:
        self.number = next(_numbers)
        descriptor = os.memfd_create("libero")
        try:
            os.ftruncate(descriptor, SIZE)
            self._map(descriptor)
        except OSError:
            os.close(descriptor)
            raise
        # A spawned process inherits the descriptor.
        self._descriptor: int | None = descriptor
        _shared[self.number] = self

    def close_descriptor(self) -> None:
        """Closes the descriptor, after the process has been started. The memory stays mapped."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def dumps(self, message: Any) -> bytes:
        """Pickles a message and writes its large arrays to the memory. Arrays that do not
        fit stay in the pickle."""
        data = io.BytesIO()
        _Pickler(data, self).dump(message)
        return data.getvalue()

    def array(self, offset: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
        """Returns a view of the array at an offset, in bytes, into the memory."""
        count = int(np.prod(shape))
        return np.frombuffer(self._memory, dtype, count, offset).reshape(shape)

    def _map(self, descriptor: int) -> None:
        self._memory = mmap.mmap(descriptor, SIZE)

    def __getstate__(self) -> Any:
        assert self._descriptor is not None
        return self.number, reduction.DupFd(self._descriptor)

    def __setstate__(self, state: Any) -> None:
        self.number, duplicate = state
        self._descriptor = duplicate.detach()
        self._map(self._descriptor)
        self.close_descriptor()


class _Pickler(reduction.ForkingPickler):
    """Pickler that writes large arrays to shared memory."""

    def __init__(self, file: io.BytesIO, memory: SharedMemory) -> None:
        super().__init__(file)
        self._shared = memory
        self._used = 0

    def reducer_override(self, value: Any) -> Any:
        if (
            type(value) is not np.ndarray
            or value.nbytes < _SMALL
            or self._used + value.nbytes > SIZE
            or value.dtype.hasobject
            or not value.flags.c_contiguous
        ):
            return NotImplemented
        offset = self._used
        np.copyto(self._shared.array(offset, value.shape, value.dtype), value)
        self._used += -(-value.nbytes // _ALIGNED) * _ALIGNED
        return _copy_from_memory, (self._shared.number, offset, value.shape, value.dtype)


def _copy_from_memory(
    number: int, offset: int, shape: tuple[int, ...], dtype: np.dtype[Any]
) -> NDArray[Any]:
    return _shared[number].array(offset, shape, dtype).copy()


def create() -> SharedMemory | None:
    """Returns new shared memory; None on a system that has none, where messages hold all arrays."""
    if not hasattr(os, "memfd_create"):
        return None
    try:
        return SharedMemory()
    except OSError:
        return None
