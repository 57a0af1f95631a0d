"""What a grammar is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

Templates = Sequence[str]
"""Sentences with ``{slots}`` and ``[one|of|these]``, which nest; ``[|please]`` may be empty."""
Grammar = Mapping[str, Templates]
"""What each slot may be filled with."""
