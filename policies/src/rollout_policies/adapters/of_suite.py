"""Policies whose every suite has its own weights, so that a server serves one suite and refuses
episodes of another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..catalogue import Entry
from ..description import Description
from ..episode import Episode
from ..policy import Policy
from .upstream import require_suite


class PolicyOfSuite(Policy):
    """A policy with a suite's weights. `slots` are its own settings, and `described` fields of its
    description."""

    def __init__(
        self,
        entry: Entry,
        model: Any,
        slots: Mapping[str, str],
        *,
        suite: str,
        checkpoint: str,
        weights: str = "",
        settings: Mapping[str, str] | None = None,
        **described: Any,
    ) -> None:
        self.entry, self.suite, self.model = entry, suite, model
        self.description = Description(
            name=entry.name,
            checkpoint=checkpoint,
            checkpoint_digest=weights,
            parameters=model.parameters,
            settings={**(settings or {}), **slots},
            **described,
        )

    def reset(self, episode: Episode) -> None:
        require_suite(self.entry, self.suite, episode)
