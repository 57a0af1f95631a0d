"""Cameras that the user declares unused in an environment variable: they are not drawn."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection

#: Names of cameras, separated by commas. Leaving out cameras that the policy does not use saves
#: drawing time in programs that read or send every frame of every step.
VARIABLE = "ROLLOUT_UNUSED_CAMERAS"

_warned: set[str] = set()


def unused_cameras(known: Collection[str]) -> frozenset[str]:
    """Returns the cameras that the environment variable names. Warns once per camera that its
    frames are black, because a policy that does use the camera would fail without another sign.

    Raises ValueError for a camera that the scene (`known`) lacks."""
    names = (name.strip() for name in os.environ.get(VARIABLE, "").split(","))
    unused = frozenset(name for name in names if name)
    for name in sorted(unused):
        if name not in known:
            raise ValueError(
                f"{VARIABLE} names `{name}`, and there is no such camera: choose from "
                f"{', '.join(known)}, or unset the variable"
            )
        if name not in _warned:
            _warned.add(name)
            print(
                f"rollout-libero-shim: {VARIABLE} names {name}: its frames are black, not drawn",
                file=sys.stderr,
            )
    return unused
