"""Cameras that whoever starts a program says it does not use: they are not drawn."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection

#: Names of cameras, divided by commas. Programs that read or send every frame of every step, of
#: cameras that their policy is not shown, are spared the drawing.
VARIABLE = "ROLLOUT_UNUSED_CAMERAS"

_said: set[str] = set()


def unused_cameras(known: Collection[str]) -> frozenset[str]:
    """Returns the cameras that the environment variable names. Says once in a process that
    their frames are black, since a policy that is shown them would look bad for no fault of its.

    Raises ValueError for a camera that is not among those of the scene.
    """
    names = (name.strip() for name in os.environ.get(VARIABLE, "").split(","))
    unused = frozenset(name for name in names if name)
    for name in sorted(unused):
        if name not in known:
            raise ValueError(
                f"{VARIABLE} names `{name}`, and there is no such camera: choose of "
                f"{', '.join(known)}, or unset it"
            )
        if name not in _said:
            _said.add(name)
            print(
                f"rollout-libero-shim: {VARIABLE} names {name}: its frames are black, not drawn",
                file=sys.stderr,
            )
    return unused
