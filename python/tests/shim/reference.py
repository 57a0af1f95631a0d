"""What the shim is held against, beside the checkout; tests skip where it is missing."""

from __future__ import annotations

import functools
from pathlib import Path

import rollout_libero

SHARED = Path(__file__).resolve().parents[4] / "shared"


@functools.cache
def fetched_assets() -> Path | None:
    """LIBERO's assets, or none without a network."""
    try:
        return rollout_libero.fetch_assets()
    except FileNotFoundError as error:
        print(f"skipped: failed to {error}")
        return None
