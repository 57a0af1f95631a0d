"""Types of a grammar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

Templates = Sequence[str]
"""Sentences with ``{slots}`` and ``[one|of|these]``, which may nest; ``[|please]`` is optional."""
Grammar = Mapping[str, Templates]
"""Templates that may fill each slot."""
