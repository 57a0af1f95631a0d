"""How long something takes."""

from __future__ import annotations

import time
from typing import Any


class Timer:
    """Measures the time, s, of what is done `with` it: `value`."""

    value: float

    def __enter__(self) -> Timer:
        self.value = 0.0
        self._start = time.perf_counter()
        return self

    def __exit__(self, *_error: Any) -> None:
        self.value = time.perf_counter() - self._start

    def get_elapsed_time(self) -> float:
        """The time that was measured, s."""
        return self.value
