"""The one thread that touches a policy.

Compiled models belong to the thread that compiled them: CUDA graphs fail in any
other. So requests, which come in many threads, are answered in turn by one.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any


class InferenceThread:
    """Calls that wait for their turn; the thread that calls `work` makes them."""

    def __init__(self) -> None:
        self._calls: queue.SimpleQueue[tuple[Future, Callable, tuple] | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._closed = False

    def submit(self, call: Callable, *arguments: Any) -> Future:
        """Makes a call after those that came before. The result is cancelled if
        the work is over."""
        answer: Future = Future()
        with self._lock:
            if self._closed:
                answer.cancel()
            else:
                self._calls.put((answer, call, arguments))
        return answer

    def work(self, sweep: Callable[[], None], every_secs: float) -> None:
        """Makes calls, in this thread, until `close`; calls `sweep` now and then."""
        sweep_at = time.monotonic() + every_secs
        while True:
            # Before each call: where calls never stop coming, nothing is ever idle.
            left = sweep_at - time.monotonic()
            if left <= 0:
                sweep()
                sweep_at = time.monotonic() + every_secs
                continue
            try:
                waiting = self._calls.get(timeout=left)
            except queue.Empty:
                continue
            if waiting is None:
                return
            answer, call, arguments = waiting
            if self._closed:
                answer.cancel()
            elif answer.set_running_or_notify_cancel():
                try:
                    answer.set_result(call(*arguments))
                except BaseException as error:
                    # To whoever waits for it: this thread has more to do.
                    answer.set_exception(error)

    def close(self) -> None:
        """Ends `work` after the call under way, and cancels what waits."""
        with self._lock:
            if not self._closed:
                self._closed = True
                self._calls.put(None)
