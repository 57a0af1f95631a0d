"""The single thread that calls a policy.

Compiled models belong to the thread that compiled them: CUDA graphs fail in any other thread. So
one thread answers, in turn, the requests that arrive in many threads."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any


class InferenceThread:
    """A queue of calls, which are made in the thread that runs `work`."""

    def __init__(self) -> None:
        self._calls: queue.SimpleQueue[tuple[Future, Callable, tuple] | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._closed = False

    def submit(self, call: Callable, *arguments: Any) -> Future:
        """Queues a call behind earlier ones. The returned future is cancelled if `close` is called
        before the call begins."""
        answer: Future = Future()
        with self._lock:
            if self._closed:
                answer.cancel()
            else:
                self._calls.put((answer, call, arguments))
        return answer

    def work(self, sweep: Callable[[], None], every_secs: float) -> None:
        """Makes the queued calls in this thread until `close`, and calls `sweep` at intervals."""
        sweep_at = time.monotonic() + every_secs
        while True:
            # Compares the time before each call, because `get` never times out while calls keep
            # arriving.
            remaining_secs = sweep_at - time.monotonic()
            if remaining_secs <= 0:
                sweep()
                sweep_at = time.monotonic() + every_secs
                continue
            try:
                queued = self._calls.get(timeout=remaining_secs)
            except queue.Empty:
                continue
            if queued is None:
                return
            answer, call, arguments = queued
            if self._closed:
                answer.cancel()
            elif answer.set_running_or_notify_cancel():
                try:
                    answer.set_result(call(*arguments))
                except BaseException as error:
                    # The error goes to the waiting caller, and this thread continues.
                    answer.set_exception(error)

    def close(self) -> None:
        """Ends `work` after the current call, and cancels the queued ones."""
        with self._lock:
            if not self._closed:
                self._closed = True
                self._calls.put(None)
