"""Many environments in one process, for reinforcement learning of a policy.

``TrainingEnvironment`` can do more than ``VectorEnvironment``, which has gymnasium's interface: it
runs the task of any BDDL file, and another task at each reset; starts from a given state, as the
original's ``set_init_state`` does, or in the middle of a finished rollout; executes chunks of
actions past success; and accepts calls for some rows only."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rollout_libero import files, scenes
from rollout_libero._library import native
from rollout_libero.capsule import Capsule
from rollout_libero.observation import (
    ACTION_WIDTH,
    CAMERAS,
    READINGS,
    Observation,
    Orientation,
    Render,
    is_absolute,
    is_mirrored,
)
from rollout_libero.rollout import REFUSED
from rollout_libero.tasks import Task

LOADS = 2
"""Number of times that the original has loaded a task's model after an environment was created,
seeded and reset once."""


class Stepped(NamedTuple):
    """The results of a chunk, in the order of the rows."""

    observation: Observation
    """Observation after the last step; with ``render="all"`` its arrays are [rows, steps, …]."""
    success: NDArray[np.bool_]
    """[rows, steps]: true if the goal holds after the step."""


@dataclass(frozen=True)
class Start:
    """The start of a row's rollout, equal to a script's start of an ``OffScreenRenderEnv``: its
    construction, ``seed(seed)``, ``reset()``, ``set_init_state(state)``, and settling steps."""

    task: str
    """A BDDL file, or the name of one of the forty tasks, ``libero_goal/3``."""
    state: NDArray[np.float64] | None = None
    """Time, s, joint positions and velocities; None keeps the samplers' placement of all
    objects."""
    seed: int = 0
    """Seed of NumPy's legacy generator, which places fixtures and, without a state, all objects."""
    loads: int = LOADS
    """Number of times that the original would have loaded the task's model after this start's
    ``reset()``. Each reset of a reused environment adds one load."""


class TrainingEnvironment:
    """Rows of environments that start and step together, on threads of this process.

    Args:
        num_envs: the number of rows.
        assets, look: as in ``Environment``.
        threads: number of threads; by default one per core.
        cameras, height, width, orientation: settings of the frames, as in ``Environment``. Arrays
            are contiguous, and new in each call, so ``torch.from_numpy`` can take them over.
        control: ``"relative"`` or ``"absolute"``, as in ``Environment``.
        settle_steps, settle_action: number of control steps before the first observation, and
            their action. A capsule's rollout has settled in its own way.
        failures: file of capsules, in whose states rollouts begin unless `reset` gets starts.

    Rows with equal starts in one call, that is, with the same task, state, seed and number of
    loads, are simulated only once until they have settled. If a row fails, the other rows finish;
    the exception, ``SimulationError``, has the failed rows as ``environments`` and the results of
    the call as ``result``."""

    def __init__(
        self,
        num_envs: int,
        assets: str | PathLike[str] | None = None,
        *,
        threads: int | None = None,
        cameras: Sequence[str] = CAMERAS,
        height: int = 256,
        width: int = 256,
        orientation: Orientation = "policy",
        control: Literal["relative", "absolute"] = "relative",
        settle_steps: int = 10,
        settle_action: Sequence[float] = (0, 0, 0, 0, 0, 0, -1),
        look: str | None = None,
        failures: str | PathLike[str] | None = None,
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"failed to make {num_envs} environments: at least one is needed")
        if settle_steps < 0 or len(settle_action) != ACTION_WIDTH:
            raise ValueError(
                f"failed to settle in {settle_steps} steps with an action of {len(settle_action)} "
                f"numbers: give 0 steps or more, and {ACTION_WIDTH} numbers"
            )
        self.num_envs = num_envs
        self._assets = assets
        self._look = look
        self._threads = threads or len(os.sched_getaffinity(0))
        self._cameras = [(camera, width, height) for camera in cameras]
        self._mirrored = is_mirrored(orientation)
        self._absolute = is_absolute(control)
        self._settle = (settle_steps, [float(number) for number in settle_action])
        self.simulations: list[native.Simulation | None] = [None] * num_envs
        self.failures = [] if failures is None else Capsule.read(failures)
        self.starts: list[Start | Capsule | None] = [None] * num_envs
        """Start of each row's rollout."""
        self._generator = np.random.default_rng()

    def reset(
        self,
        starts: Sequence[Start | Capsule] | None = None,
        rows: Sequence[int] | None = None,
        render: Literal["last", "none"] = "last",
        *,
        seed: int | None = None,
    ) -> Observation:
        """Begins a rollout in each of the rows, by default in all, with a start for each. By
        default, each start is drawn from ``failures``, and its number of steps from those up to the
        capsule's; ``seed`` seeds these draws. Returns the observations of these rows, without
        frames if ``render="none"``. Raises FileNotFoundError if files are missing; ValueError if
        there is no such task or row, a state is of another task, or a rollout does not repeat.

        After an error, other rows may have begun their rollouts, or lost their earlier ones."""
        rows = self._rows(rows)
        if seed is not None:
            self._generator = np.random.default_rng(seed)
        if starts is None:
            starts = [self._drawn() for _ in rows]
        if len(starts) != len(rows):
            raise ValueError(
                f"failed to begin in {len(rows)} rows: {len(starts)} starts were given"
            )
        # All scenes are compiled before any row changes, as files may be missing.
        compiled = [self._scene(start) for start in starts]
        for row, scene, start in zip(rows, compiled, starts, strict=True):
            self._assign(row, scene)
            self.starts[row] = start
        # Equal starts are simulated once, in the first row that has them.
        first: dict[tuple[str, str], int] = {}
        leader_of = [
            first.setdefault((_bddl_file(start.task), self._start_json(start)), at)
            for at, start in enumerate(starts)
        ]
        leaders = sorted(first.values())
        simulations = [self._simulation(rows[at]) for at in leaders]
        result = self._advance(
            simulations,
            np.empty((len(simulations), 0, ACTION_WIDTH)),
            [self._start_json(starts[at]) for at in leaders],
            render,
        )
        errors = dict(zip(leaders, result["errors"], strict=True))
        for at, leader in enumerate(leader_of):
            if at != leader and errors[leader] is None:
                self._simulation(rows[at]).restore(self._simulation(rows[leader]).snapshot())
        order = np.searchsorted(leaders, leader_of)
        observation = {
            name: values if len(leaders) == len(rows) else values[order]
            for name, values in self._observation(result).items()
        }
        return _finished(observation, rows, [errors[leader] for leader in leader_of])

    def step_chunk(
        self, actions: ArrayLike, rows: Sequence[int] | None = None, render: Render = "last"
    ) -> Stepped:
        """Executes control steps of the rows, by default of all, with actions [rows, steps, 7]. All
        actions are executed, even past success. Raises ValueError for actions of another shape, and
        for rows without a rollout; no row has moved then."""
        rows = self._rows(rows)
        actions = np.asarray(actions, dtype=np.float64)
        if actions.ndim != 3 or actions.shape[0] != len(rows) or not actions.shape[1]:
            raise ValueError(
                f"failed to step with actions of shape {actions.shape}: expected [{len(rows)}, "
                "steps, 7]"
            )
        result = self._advance(
            [self._simulation(row) for row in rows], actions, [None] * len(rows), render
        )
        stepped = Stepped(self._observation(result), result["successes"])
        return _finished(stepped, rows, result["errors"])

    def observe(
        self, rows: Sequence[int] | None = None, render: Literal["last", "none"] = "last"
    ) -> Observation:
        """Returns the last observations of the rows, by default of all; without frames if
        ``render="none"``. Raises ValueError if a row has no rollout."""
        rows = self._rows(rows)
        simulations = [self._simulation(row) for row in rows]
        no_actions = np.empty((len(rows), 0, ACTION_WIDTH))
        result = self._advance(simulations, no_actions, [None] * len(rows), render)
        return _finished(self._observation(result), rows, result["errors"])

    def frame(self, row: int, camera: str, width: int, height: int) -> NDArray[np.uint8]:
        """Returns an upright picture, in any size, of the scene at a row's last observation."""
        return self._simulation(row).frame(camera, width, height)[::-1]

    def snapshot(self, row: int) -> native.Snapshot:
        """Returns a row's complete state, from which `restore` continues the rollout."""
        return self._simulation(row).snapshot()

    def restore(self, row: int, snapshot: native.Snapshot) -> None:
        """Continues a row from a snapshot of a row of the same task."""
        self._simulation(row).restore(snapshot)

    def close(self) -> None:
        """Frees the environments."""
        for simulation in self.simulations:
            if simulation is not None:
                simulation.close()
        self.simulations = [None] * self.num_envs

    def _drawn(self) -> Capsule:
        """Draws a start from the failures."""
        if not self.failures:
            raise ValueError("failed to begin: give starts, or make the environment with failures")
        capsule = self.failures[int(self._generator.integers(len(self.failures)))]
        return capsule.until(int(self._generator.integers(capsule.steps + 1)))

    def _scene(self, start: Start | Capsule) -> native.Scene:
        if isinstance(start, Capsule):
            return scenes.scene_of_task(Task.of(start.task), self._assets, self._look)
        return scenes.scene(_bddl_file(start.task), self._assets, self._look)

    def _assign(self, row: int, scene: native.Scene) -> None:
        """Gives a row a simulation of the scene, unless it has one."""
        simulation = self.simulations[row]
        if simulation is None or simulation.scene is not scene:
            if simulation is not None:
                simulation.close()
            self.simulations[row] = native.Simulation(scene)

    def _simulation(self, row: int) -> native.Simulation:
        simulation = self.simulations[row]
        if simulation is None:
            raise ValueError(f"failed to use row {row}: it has no rollout; call reset")
        return simulation

    def _rows(self, rows: Sequence[int] | None) -> list[int]:
        chosen = list(range(self.num_envs)) if rows is None else [int(row) for row in rows]
        if not chosen or len(set(chosen)) != len(chosen):
            raise ValueError(
                f"failed to choose rows {chosen}: give at least one row, and each row once"
            )
        if not all(0 <= row < self.num_envs for row in chosen):
            raise ValueError(f"failed to choose rows {chosen}: rows are 0 to {self.num_envs - 1}")
        return chosen

    def _start_json(self, start: Start | Capsule) -> str:
        if isinstance(start, Capsule):
            return start.json()
        steps, action = self._settle
        fields = {
            "legacy_seed": start.seed,
            "rounds": start.loads,
            "settle_steps": steps,
            "settle_action": action,
        }
        if start.state is not None:
            fields["state"] = np.asarray(start.state, dtype=np.float64).tolist()
        return json.dumps(fields)

    def _advance(
        self,
        simulations: list[native.Simulation],
        actions: NDArray[np.float64],
        starts: Sequence[str | None],
        render: Render = "last",
    ) -> dict[str, Any]:
        return native.Batch(simulations, self._threads).advance(
            actions,
            [actions.shape[1]] * len(simulations),
            starts,
            self._cameras,
            render=render,
            absolute=self._absolute,
            mirrored=self._mirrored,
            past_success=True,
        )

    def _observation(self, result: dict[str, Any]) -> Observation:
        names = [*(camera for camera, _, _ in self._cameras), *READINGS]
        return {name: result[name] for name in names if name in result}


def _bddl_file(task: str) -> str:
    if str(task).endswith(".bddl"):
        return os.path.realpath(task)
    return str(files.bddl_file(Task.of(task)))


def _finished(result: Any, rows: Sequence[int], errors: Sequence[Exception | None]) -> Any:
    """Returns the results of a call, or raises the first error with the results attached."""
    failed = [row for row, error in zip(rows, errors, strict=True) if error is not None]
    if not failed:
        return result
    error: Any = next(error for error in errors if error is not None)
    if not isinstance(error, REFUSED):
        error.environments, error.result = failed, result
    raise error
