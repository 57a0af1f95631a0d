"""The shim's references, in a folder beside the checkout; tests skip if it is missing."""

from __future__ import annotations

import functools
from pathlib import Path

import rollout_libero

SHARED = Path(__file__).resolve().parents[4] / "shared"


@functools.cache
def fetched_assets() -> Path | None:
    """Returns LIBERO's assets, or None without a network."""
    try:
        return rollout_libero.fetch_assets()
    except FileNotFoundError as error:
        print(f"skipped: {error}")
        return None
