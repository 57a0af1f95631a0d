"""LIBERO-Plus: the files that its variants need."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from rollout_libero import files
from rollout_libero._library import native


def check_assets(bddl_file: str | PathLike[str], assets: str | PathLike[str] | None) -> None:
    """Checks that an asset pack suffices for the variant that the path of a BDDL file names.

    Raises:
        FileNotFoundError: if it does not; the message names the missing files."""
    name = Path(bddl_file).stem
    variant = native.PlusVariant.find(name)
    lack = variant and variant.lack(files.assets(assets), files.sources())
    if lack:
        raise FileNotFoundError(
            f"failed to make the variant {name}, which lacks {lack}: choose a variant of LIBERO's "
            "own files, or, for a background or light, set ROLLOUT_ASSETS to the unpacked archive "
            "(docs/FAMILY.md)"
        )
