"""The types of which a grammar consists."""

from collections.abc import Mapping, Sequence

Templates = Sequence[str]
"""Words, phrases or sentences with slots, ``{slot}``, and choices, ``[first|second]``. Choices may
nest, and an option may be empty: ``[|please]``."""
Grammar = Mapping[str, Templates]
"""For each slot, by its name, the templates that may fill the slot. A repeated template is drawn
more often."""
