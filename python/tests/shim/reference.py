"""What the shim is held against, beside the checkout; tests skip where it is missing."""

from __future__ import annotations

from pathlib import Path

SHARED = Path(__file__).resolve().parents[4] / "shared"
#: LIBERO's assets.
ASSETS = SHARED / "libero-assets"
