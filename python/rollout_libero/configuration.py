"""Start of a rollout, as JSON for the simulator."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from rollout_libero._library import native
from rollout_libero.capsule import Capsule
from rollout_libero.tasks import Task

InitStates = str | int | Sequence[int]
"""``"cycle"``: 0, 1, 2, … from reset to reset; ``"random"``: drawn by the environment's generator;
``"sampled"``: new placements by LIBERO's samplers; a number: always this state; numbers: these
states in turn."""


Perturbation = str | Mapping[str, Any] | Capsule
"""A configuration of LIBERO-CTRL, ``simultaneous/L2/c03``; a row of a manifest; or a finished
rollout, after whose steps, and under whose perturbations, rollouts begin."""


class Start(NamedTuple):
    row: str
    """JSON for the simulator: a manifest row, the seed of a sampled placement, or a capsule."""
    init_state: int | None
    """None if LIBERO's samplers place the objects."""
    instruction: str
    max_steps: int
    execution: str
    """Execution model: the robot's behaviour while an answer is computed."""
    turn: int
    """The environment's position in the sequence of starts, after this start."""
    generator: np.random.Generator
    """The environment's generator after the draws of this start."""


class Starts:
    """Chooses the start of each rollout of one environment.

    Environments of one task that take turns share the sequence: each begins at its ``rank`` among
    them and advances by their number, ``stride``."""

    def __init__(
        self,
        task: Task,
        count: int,
        init_states: InitStates,
        *,
        settle_steps: int | None,
        max_steps: int | None,
        perturbation: Perturbation | None,
        absolute: bool,
        execution: str | None = None,
        rank: int = 0,
        stride: int = 1,
    ) -> None:
        if max_steps is not None and max_steps < 1:
            raise ValueError(f"failed to set max_steps {max_steps}: it must be 1 or more, or None")
        if settle_steps is not None and settle_steps < 0:
            raise ValueError(
                f"failed to set settle_steps {settle_steps}: it must be 0 or more, or None"
            )
        self._task = task
        self._count = count
        self._chosen = _choose(init_states, count)
        self._settle_steps = settle_steps
        self._max_steps = max_steps
        self._absolute = absolute
        self._execution = execution
        self.rank = rank
        self._stride = stride
        self._turn = rank
        self.perturb(perturbation)

    @property
    def instruction(self) -> str:
        return self._task.instruction if self._perturbed is None else self._perturbed["language"]

    @property
    def max_steps(self) -> int:
        """Returns the step budget of the next rollout."""
        if self._max_steps is not None:
            return self._max_steps
        if self._capsule is not None:
            return self._capsule.max_steps
        return self._task.max_steps if self._perturbed is None else self._perturbed["max_steps"]

    @property
    def execution(self) -> str:
        """The execution model of the next rollout: the given one, else that of the manifest row."""
        return self._execution_of(self._perturbed)

    def perturb(self, perturbation: Perturbation | None) -> None:
        """Perturbs all later rollouts; with a capsule, they begin after its steps. Raises
        ValueError if the task has no such configuration, its actuation axis distorts actions that
        are poses, or its execution model does not fit; the previous perturbation stays in
        effect."""
        capsule = perturbation if isinstance(perturbation, Capsule) else None
        if isinstance(perturbation, Capsule):
            # The actions are those that were executed while answers were under way, too.
            perturbation = {**perturbation.row, "execution": "wait"}
        row = None if perturbation is None else _row(self._task, perturbation)
        self._check_execution(self._execution_of(row))
        if row is not None:
            axes = native.perturbed_axes(json.dumps(row))
            if self._absolute and "actuation" in axes:
                raise ValueError(
                    f"failed to perturb {self._task.name} by {row['rollout_id']}: its actuation "
                    "axis distorts displacements, and control='absolute' commands poses; use "
                    "control='relative', or a configuration without the actuation axis"
                )
        self._perturbed, self._capsule = row, capsule

    def plan(
        self, generator: np.random.Generator, options: Mapping[str, Any], *, turn: int | None = None
    ) -> Start:
        """Returns the next start, at the given turn, or else at the environment's turn. Changes
        nothing: pass the start to ``use`` after the rollout has begun. Raises ValueError if the
        option ``init_state`` is not a state of the task."""
        generator = copy.deepcopy(generator)
        turn = self._turn if turn is None else turn
        init_state = options.get("init_state")
        if self._capsule is not None:
            if init_state is not None:
                raise ValueError("failed to choose an initial state: a capsule has its own")
            return self._start(self._capsule.json(), self._capsule.row["init_id"], turn, generator)
        if init_state is not None:
            init_state = self._checked(init_state)
        elif self._chosen == "sampled":
            sampled = {
                "sampled": int(generator.integers(2**32, dtype=np.uint32)),
                "settle_steps": self._settle_steps_of(self._perturbed or self._nominal(0)),
                "perturbed": self._perturbed,
            }
            return self._start(json.dumps(sampled), None, turn, generator)
        if self._perturbed is not None:
            row = dict(self._perturbed)
            if init_state is not None:
                row["init_id"] = init_state
        elif init_state is not None:
            row = self._nominal(init_state)
        elif self._chosen == "random":
            row = self._nominal(int(generator.integers(self._count)))
        else:
            assert not isinstance(self._chosen, str)
            row = self._nominal(self._chosen[turn % len(self._chosen)])
            turn += self._stride
        row["num_steps_wait"] = self._settle_steps_of(row)
        return self._start(json.dumps(row), row["init_id"], turn, generator)

    def use(self, start: Start) -> None:
        """Advances the sequence past a start."""
        self._turn = start.turn

    def _start(self, row: str, init_state: int | None, turn: int, generator: Any) -> Start:
        return Start(
            row, init_state, self.instruction, self.max_steps, self.execution, turn, generator
        )

    def _execution_of(self, row: Mapping[str, Any] | None) -> str:
        row_execution = "wait" if row is None else row.get("execution", "wait")
        if self._execution in (None, row_execution):
            return row_execution
        if row is not None and row["axis"] == "latency":
            raise ValueError(
                f"failed to run {row['rollout_id']} under execution model {self._execution!r}: the "
                f"row's latency axis already sets {row_execution!r}; leave out `execution`"
            )
        return self._execution

    def _check_execution(self, execution: str) -> None:
        """Refuses a model that is invalid, or incompatible with the control or initial states."""
        native.Schedule(execution, self._task.name, 0)
        if execution != "wait" and self._absolute:
            raise ValueError(
                f"failed to run under execution model {execution!r}: an arm that holds still is "
                "commanded a displacement of zero, and control='absolute' commands poses; use "
                "control='relative'"
            )
        if "*" in execution and self._chosen == "sampled":
            raise ValueError(
                f"failed to run under execution model {execution!r}: the initial state's number "
                "seeds the delays, and init_states='sampled' has no number; choose a constant delay"
            )

    def _nominal(self, init_state: int) -> dict[str, Any]:
        row: dict[str, Any] = json.loads(native.nominal_row(self._task.name, init_state))
        return row

    def _settle_steps_of(self, row: Mapping[str, Any]) -> int:
        """Returns the number of control steps without action before the first observation."""
        return row["num_steps_wait"] if self._settle_steps is None else self._settle_steps

    def _checked(self, init_state: int) -> int:
        if not 0 <= int(init_state) < self._count:
            raise ValueError(
                f"failed to begin at initial state {init_state}: {self._task.name} has 0 to "
                f"{self._count - 1}"
            )
        return int(init_state)


def _choose(init_states: InitStates, count: int) -> str | Sequence[int]:
    """Returns ``"random"``, ``"sampled"``, or the initial states that take turns. Raises
    ValueError."""
    if init_states == "cycle":
        return range(count)
    if init_states in ("random", "sampled"):
        return init_states
    if isinstance(init_states, str):
        raise ValueError(
            f"failed to choose init_states {init_states!r}: it must be 'cycle', 'random', "
            "'sampled', a number, or numbers"
        )
    listed = [init_states] if isinstance(init_states, int | np.integer) else init_states
    numbers = [int(number) for number in listed]
    if not numbers or not all(0 <= number < count for number in numbers):
        raise ValueError(
            f"failed to choose init_states {init_states!r}: the task has 0 to {count - 1}"
        )
    return numbers


def _row(task: Task, perturbation: str | Mapping[str, Any]) -> dict[str, Any]:
    """Returns the manifest row of a rollout id, of a rollout id without suite and task, such as
    ``simultaneous/L2/c03``, or the given row itself."""
    if isinstance(perturbation, str):
        text = perturbation
        if text.count("/") == 2:
            nominal = json.loads(native.nominal_row(task.name, 0))["rollout_id"]
            text = "/".join([*nominal.split("/")[:2], text])
        row = json.loads(native.configuration_row(text))
    else:
        row = dict(perturbation)
    task_of_row = f"{row.get('suite')}/{row.get('task_id')}"
    if task_of_row != task.name:
        raise ValueError(f"failed to perturb {task.name}: the configuration is of {task_of_row}")
    return row
