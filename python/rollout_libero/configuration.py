"""Where and how a rollout begins, as a manifest's row (JSON)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rollout_libero._library import native
from rollout_libero.tasks import Task

InitStates = str | int | Sequence[int]
"""``"cycle"``: 0, 1, 2, … from reset to reset; ``"random"``: drawn by the environment's
generator; ``"sampled"``: placed anew by LIBERO's samplers; a number: always this one;
numbers: these in turn."""


class Starts:
    """Says where the next rollout of one environment begins."""

    def __init__(
        self,
        task: Task,
        count: int,
        init_states: InitStates,
        settle_steps: int,
        perturbation: str | Mapping[str, Any] | None,
    ) -> None:
        self._task = task
        self._count = count
        self._chosen = _chosen(init_states, count)
        self._settle_steps = settle_steps
        self._turn = 0
        self.perturb(perturbation)

    def perturb(self, perturbation: str | Mapping[str, Any] | None) -> None:
        """Has the next rollouts perturbed so."""
        self._perturbed = None if perturbation is None else _row(self._task, perturbation)
        self.instruction = self._task.instruction
        if self._perturbed is not None:
            self.instruction = self._perturbed["language"]

    def restart(self) -> None:
        """Starts the turns over, as a seed does."""
        self._turn = 0

    def next(
        self, generator: np.random.Generator, options: Mapping[str, Any]
    ) -> tuple[str, int | None]:
        """The next start, and its initial state; none if objects are placed anew."""
        wanted = options.get("init_state")
        if wanted is None and self._chosen == "sampled":
            seed = int(generator.integers(2**32, dtype=np.uint32))
            start = {"sampled": seed, "settle_steps": self._settle_steps}
            return json.dumps(start | {"perturbed": self._perturbed}), None
        if self._perturbed is not None:
            row = dict(self._perturbed)
            if wanted is not None:
                row["init_id"] = self._checked(wanted)
            row["num_steps_wait"] = self._settle_steps
            return json.dumps(row), row["init_id"]
        if wanted is not None:
            init_state = self._checked(wanted)
        elif self._chosen == "random":
            init_state = int(generator.integers(self._count))
        else:
            init_state = self._chosen[self._turn % len(self._chosen)]
            self._turn += 1
        row = json.loads(native.nominal_row(self._task.name, init_state))
        row["num_steps_wait"] = self._settle_steps
        return json.dumps(row), init_state

    def _checked(self, init_state: int) -> int:
        if not 0 <= int(init_state) < self._count:
            raise ValueError(
                f"begin at initial state {init_state}: {self._task.name} has 0 to {self._count - 1}"
            )
        return int(init_state)


def _chosen(init_states: InitStates, count: int) -> str | Sequence[int]:
    if init_states == "cycle":
        return range(count)
    if init_states in ("random", "sampled"):
        return init_states
    if isinstance(init_states, str):
        raise ValueError(
            f"choose init_states {init_states!r}: it is 'cycle', 'random', 'sampled', a number, or "
            "numbers"
        )
    numbers = [init_states] if isinstance(init_states, int) else [int(it) for it in init_states]
    if not numbers or not all(0 <= number < count for number in numbers):
        raise ValueError(f"choose init_states {init_states!r}: the task has 0 to {count - 1}")
    return numbers


def _row(task: Task, perturbation: str | Mapping[str, Any]) -> dict[str, Any]:
    """The row of ``combination/L2/c03`` (of this task), of a whole rollout's id, or as it
    is given."""
    if isinstance(perturbation, str):
        text = perturbation
        if text.count("/") == 2:
            nominal = json.loads(native.nominal_row(task.name, 0))["rollout_id"]
            text = "/".join([*nominal.split("/")[:2], text])
        row = json.loads(native.configuration_row(text))
    else:
        row = dict(perturbation)
    given = f"{row.get('suite')}/{row.get('task_id')}"
    if given != task.name:
        raise ValueError(f"perturb {task.name}: the configuration is of {given}")
    return row
