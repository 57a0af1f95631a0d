"""Reports of failed constructions."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

_said: set[str] = set()


@contextmanager
def said_when_it_fails() -> Iterator[None]:
    """Prints once on standard error why a construction failed, and raises the error:
    some programs catch every error and silently construct again, without end."""
    try:
        yield
    except Exception as error:
        words = f"{type(error).__name__}: {error}"
        if words not in _said:
            _said.add(words)
            print(f"rollout-libero-shim: no environment was made: {words}", file=sys.stderr)
        raise
