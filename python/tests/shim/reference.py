"""The shim's references, in the folder `shared` beside the checkout. Tests that need the folder are
skipped without it."""

import functools
from pathlib import Path

import rollout_libero

SHARED = Path(__file__).resolve().parents[4] / "shared"


@functools.cache
def fetched_assets() -> Path | None:
    """Returns the folder of LIBERO's assets, or None if the assets cannot be fetched."""
    try:
        return rollout_libero.fetch_assets()
    except FileNotFoundError as error:
        print(f"skipped: {error}")
        return None
