"""Finished rollouts as starts of new ones."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Capsule:
    """A finished rollout of a campaign up to a control step. A rollout that starts from it repeats
    these steps, and continues under the same perturbations."""

    record: Mapping[str, Any]
    """The rollout as ``coordinator jobs --capsule`` wrote it."""
    steps: int
    """Number of control steps that are repeated."""

    @classmethod
    def read(cls, file: str | PathLike[str]) -> list[Capsule]:
        """Returns the rollouts of a file, one JSON object per line, each up to the last step at
        which it could be saved, or else to its end. Raises ValueError if a line is no capsule."""
        capsules = []
        for number, line in enumerate(Path(file).read_text().splitlines(), 1):
            try:
                record = json.loads(line)
                record["manifest_row"]["rollout_id"]
                capsules.append(cls(record, record.get("saved_until", len(record["actions"]))))
            except (ValueError, LookupError, TypeError) as error:
                raise ValueError(
                    f"failed to read {file}, line {number}: it is no capsule ({error!r}); "
                    "`coordinator jobs --capsule` writes capsules"
                ) from error
        if not capsules:
            raise ValueError(f"failed to read {file}: it has no capsule")
        return capsules

    def __post_init__(self) -> None:
        last = len(self.record["actions"])
        if not 0 <= self.steps <= last:
            raise ValueError(f"failed to start after {self.steps} steps: the rollout has {last}")

    def until(self, steps: int) -> Capsule:
        """Returns the same rollout up to another step, 0 to its end."""
        return replace(self, steps=steps)

    @property
    def row(self) -> Mapping[str, Any]:
        row: Mapping[str, Any] = self.record["manifest_row"]
        return row

    @property
    def task(self) -> str:
        """Name of the task, such as ``libero_goal/3``."""
        return f"{self.row['suite']}/{self.row['task_id']}"

    @property
    def instruction(self) -> str:
        return str(self.row["language"])

    @property
    def max_steps(self) -> int:
        """Number of control steps that remain of the rollout's budget."""
        return int(self.row["max_steps"]) - self.steps

    def json(self) -> str:
        """Returns the start as JSON for the simulator."""
        return json.dumps({"capsule": self.record, "steps": self.steps})
