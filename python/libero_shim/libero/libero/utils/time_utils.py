"""Timing of code blocks."""

from __future__ import annotations

import time
from typing import Any


class Timer:
    """A context manager that measures the duration of its block, s, in `value`."""

    value: float

    def __enter__(self) -> Timer:
        self.value = 0.0
        self._start = time.perf_counter()
        return self

    def __exit__(self, *_error: Any) -> None:
        self.value = time.perf_counter() - self._start

    def get_elapsed_time(self) -> float:
        """The measured time, s."""
        return self.value
