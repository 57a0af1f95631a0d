"""What a rollout ran with: the loaded distributions, and the OpenGL driver."""

from __future__ import annotations

import hashlib
import sys
from importlib import metadata


def loaded() -> dict[str, str]:
    """Returns version and digest of each distribution of which a module was imported.

    The digest is that of the files' digests in the wheel, so that an edited or rebuilt package of
    the same version shows.
    """
    imported = {name.partition(".")[0] for name in sys.modules}
    owners = metadata.packages_distributions()
    names = {owner for package in imported for owner in owners.get(package, [])}
    return {name: _identity(metadata.distribution(name)) for name in sorted(names)}


def _identity(distribution: metadata.Distribution) -> str:
    record = distribution.read_text("RECORD") or ""
    # Without what differs between installations of one wheel: programs, notes of the installer.
    files = [
        line.rpartition(",")[0]
        for line in record.splitlines()
        if "sha256=" in line and not line.startswith("../") and ".dist-info/" not in line
    ]
    digest = hashlib.sha256("\n".join(sorted(files)).encode()).hexdigest()
    return f"{distribution.version} {digest[:16]}"


def driver() -> str:
    """Returns OpenGL's name of the driver; empty if this process has drawn nothing through it."""
    gl = sys.modules.get("OpenGL.GL")
    if gl is None:
        return ""
    try:
        return (gl.glGetString(gl.GL_RENDERER) or b"").decode()
    except Exception:
        # No context is current in this thread.
        return ""
