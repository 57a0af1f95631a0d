"""Reports of failed constructions."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

_reported: set[str] = set()


@contextmanager
def report_failure() -> Iterator[None]:
    """Prints the error of a failed construction on standard error, once for each text, and raises
    it again: some programs catch every error and silently repeat the construction for ever."""
    try:
        yield
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
        if text not in _reported:
            _reported.add(text)
            print(f"rollout-libero-shim: no environment was made: {text}", file=sys.stderr)
        raise
