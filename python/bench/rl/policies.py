"""Simulated policies, which only take time or occupy the accelerator. The benchmark supplies the
actions."""

from __future__ import annotations

import multiprocessing
import time
from typing import Any

#: Side of the multiplied matrices.
_SIDE = 8192


class Policy:
    """A policy by name: `none`, `sleep:MS`, `card:MS`, `busy`.

    `none` answers at once, and `sleep:MS` after MS milliseconds; `card:MS` multiplies matrices on
    the accelerator for MS milliseconds. With `busy`, another process multiplies matrices without a
    pause, like a policy that answers another worker's environments."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.kind, _, ms = name.partition(":")
        if self.kind not in ("none", "sleep", "card", "busy"):
            raise ValueError(f"policy {name}: choose none, sleep:MS, card:MS or busy")
        self.seconds = float(ms or 0) / 1e3
        self._busy_process: Any = None
        self._products: Any = None
        if self.kind == "card":
            self._left, self._right = _matrices()
            _multiply(self._left, self._right)

    def __enter__(self) -> Policy:
        if self.kind == "busy":
            context = multiprocessing.get_context("spawn")
            self._products = context.Value("L", 0)
            self._busy_process = context.Process(
                target=_keep_busy, args=(self._products,), daemon=True
            )
            self._busy_process.start()
            while not self._products.value:
                if not self._busy_process.is_alive():
                    raise RuntimeError("the process that keeps the accelerator busy has ended")
                time.sleep(0.05)
        return self

    def __exit__(self, *_error: Any) -> None:
        if self._busy_process is not None:
            self._busy_process.terminate()
            self._busy_process.join()
            self._busy_process = None

    def answer(self) -> None:
        """Blocks for the duration of an answer."""
        if self.kind == "sleep":
            time.sleep(self.seconds)
        elif self.kind == "card":
            end = time.perf_counter() + self.seconds
            while time.perf_counter() < end:
                _multiply(self._left, self._right)

    def products(self) -> int:
        """Returns the number of matrix products that the busy process has computed."""
        return self._products.value if self._products is not None else 0


def _matrices() -> tuple[Any, Any]:
    import torch

    device = "cuda" if torch.cuda.is_available() else "cpu"
    side = _SIDE if device == "cuda" else 256
    dtype = torch.bfloat16 if device == "cuda" else torch.float32
    return tuple(torch.randn(side, side, device=device, dtype=dtype) for _ in range(2))  # type: ignore[return-value]


def _multiply(left: Any, right: Any) -> None:
    import torch

    left @ right
    if torch.cuda.is_available():
        torch.cuda.synchronize()


def _keep_busy(products: Any) -> None:
    left, right = _matrices()
    while True:
        _multiply(left, right)
        products.value += 1
