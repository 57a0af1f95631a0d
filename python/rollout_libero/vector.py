"""A gymnasium vector environment in one process."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any, Literal, NamedTuple

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from rollout_libero._library import native
from rollout_libero.capsule import Capsule
from rollout_libero.configuration import InitStates, Perturbation, Start, Starts
from rollout_libero.observation import (
    ACTION_WIDTH,
    CAMERAS,
    Observation,
    Orientation,
    Render,
    action_space,
    is_absolute,
    is_mirrored,
    observation_space,
)
from rollout_libero.rollout import UNTOUCHED, Rollout
from rollout_libero.scenes import scene_of_task
from rollout_libero.tasks import Task


class VectorSnapshot(NamedTuple):
    """The complete state that determines the environments' next step."""

    simulations: tuple[native.Snapshot, ...]
    rollouts: tuple[Rollout, ...]


class VectorEnvironment(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Environments that step together, on threads of this process.

    Environments of one task share its compiled scene. Frames, readings, rewards and ends are
    stacked, one row per environment.

    A refused call (``ValueError``, ``ResetNeeded``) changes nothing. If an environment fails in a
    call (``SimulationError``), the other environments finish their steps first; the exception's
    ``environments`` has the numbers of the environments that failed, and its ``result`` the call's
    return value, with ``infos["failed"]``. A failed rollout is over, neither terminated nor
    truncated: ``NEXT_STEP`` begins another rollout in the next step, the other modes need a reset.

    Args:
        tasks: one task, or several; environment *i* has the *i*-th, repeated cyclically.
        num_envs: number of environments; by default one per task.
        threads: number of threads; by default one per core, and always one with OpenGL.
        perturbation: a perturbation for all environments, or a list with one for each.
        init_states: initial states of rollouts; see ``configuration.InitStates``. Environments
            of one task that take turns share the sequence: of *n* environments, the *r*-th
            begins at index *r* and advances by *n*, so that no two have the same state at a time.
        execution: execution model, the robot's behaviour while a policy's answer is computed:
            ``"wait"``, ``"hold:4"``, ``"overlap:4"`` or ``"overlap:4,rtc"``, as in a campaign; by
            default that of the perturbation's row, else ``"wait"``. In all models except
            ``"wait"``, ``step_chunk`` takes the answers to the observations of the previous call,
            and runs each environment until its next query.
        execute: number of actions of an answer that are executed before the next query; by default
            all.
        autoreset_mode: gymnasium's mode. When a rollout has ended, ``NEXT_STEP`` begins another one
            in the next call of ``step``, whose action is ignored; ``SAME_STEP`` begins it in the
            same call, with the last observation in ``info["final_obs"]``; with ``DISABLED``, call
            ``reset`` with ``options={"reset_mask": …}``.

    The other arguments are those of ``Environment``."""

    def __init__(
        self,
        tasks: str | Sequence[str],
        num_envs: int | None = None,
        assets: str | PathLike[str] | None = None,
        *,
        threads: int | None = None,
        cameras: Sequence[str] = CAMERAS,
        height: int = 256,
        width: int = 256,
        orientation: Orientation = "policy",
        init_states: InitStates = "random",
        settle_steps: int | None = None,
        max_steps: int | Sequence[int] | None = None,
        perturbation: Perturbation | Sequence[Perturbation | None] | None = None,
        control: Literal["relative", "absolute"] = "relative",
        renderer: str = "software",
        look: str | None = None,
        execution: str | None = None,
        execute: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        names = [tasks] if isinstance(tasks, str) else list(tasks)
        self.num_envs = len(names) if num_envs is None else num_envs
        if not names or self.num_envs < 1:
            raise ValueError(
                "failed to make environments: give at least one task, and num_envs of at least 1"
            )
        self._absolute = is_absolute(control)
        self._execute = execute
        self._mirrored = is_mirrored(orientation)
        self.tasks = [Task.of(names[at % len(names)]) for at in range(self.num_envs)]
        scenes = [scene_of_task(task, assets, look) for task in self.tasks]
        self.simulations = [native.Simulation(scene, renderer=renderer) for scene in scenes]
        sharing = Counter(task.name for task in self.tasks)
        ranks: Counter[str] = Counter()
        self.starts = []
        perturbations = _each(perturbation, self.num_envs, "perturbation", str | Mapping | Capsule)
        budgets = _each(max_steps, self.num_envs, "max_steps", int)
        for task, scene, perturbed, budget in zip(
            self.tasks, scenes, perturbations, budgets, strict=True
        ):
            starts = Starts(
                task,
                scene.initial_states,
                init_states,
                settle_steps=settle_steps,
                max_steps=budget,
                perturbation=perturbed,
                absolute=self._absolute,
                execution=execution,
                rank=ranks[task.name],
                stride=sharing[task.name],
            )
            ranks[task.name] += 1
            self.starts.append(starts)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"autoreset_mode": self.autoreset_mode}
        self._space = observation_space(cameras, height, width)
        self.single_observation_space = self._space
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._cameras = [(camera, width, height) for camera in cameras]
        self._threads = threads or len(os.sched_getaffinity(0))
        self._batch = native.Batch(self.simulations, self._threads)
        self._generators = [seeding.np_random()[0] for _ in self.tasks]
        self.rollouts = [Rollout(starts.instruction, starts.max_steps) for starts in self.starts]
        native.Schedule("wait", self.tasks[0].name, 0, execute=execute)

    @property
    def max_steps(self) -> NDArray[np.int64]:
        """Control steps after which each rollout is truncated."""
        return np.array([rollout.max_steps for rollout in self.rollouts])

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins rollouts.

        A number seeds environment *i* with ``seed + i``; a list has a seed, or None, for each
        environment. With ``init_states="cycle"``, or numbers, a seed selects the turn: seeds of a
        list act as in ``Environment.reset``, and with a number the *r*-th environment of a task
        begins at turn ``seed + r``. ``options`` may have ``reset_mask``, [environments], True for
        the environments that begin a rollout, and ``init_state``, which takes precedence: a number
        for all environments, or a number for each."""
        options = dict(options or {})
        mask = np.asarray(options.pop("reset_mask", np.ones(self.num_envs, bool)), dtype=bool)
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"failed to reset with a mask of shape {mask.shape}: expected ({self.num_envs},) "
                "with at least one True"
            )
        init_state: Any = options.get("init_state")
        init_states = np.broadcast_to(init_state, self.num_envs)
        is_number = isinstance(seed, int | np.integer)
        seeds = _each(seed, self.num_envs, "seed", int | np.integer)
        starts = {}
        for at in np.flatnonzero(mask).tolist():
            env_seed = turn = int(seeds[at]) + at if is_number else seeds[at]
            generator = self._generators[at]
            if env_seed is not None:
                generator = seeding.np_random(env_seed)[0]
            if is_number:
                turn = int(seeds[at]) + self.starts[at].rank
            start_options = {"init_state": init_states[at]}
            starts[at] = self.starts[at].plan(generator, start_options, turn=turn)
        advanced = self._batch.advance(
            np.empty((self.num_envs, 0, ACTION_WIDTH)),
            [0] * self.num_envs,
            self._rows(starts),
            self._cameras,
            mirrored=self._mirrored,
        )
        errors = advanced["errors"]
        self._begin(starts, errors)
        infos = self._infos(np.zeros(self.num_envs, bool))
        result = self._observation(advanced), infos
        return self._finished(result, infos, errors)

    def step(
        self, actions: ArrayLike
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Executes a control step of each environment, with actions [environments, 7]."""
        actions = np.asarray(actions, dtype=np.float64)
        if actions.shape != (self.num_envs, ACTION_WIDTH):
            raise ValueError(
                f"failed to step with actions of shape {actions.shape}: expected ({self.num_envs}, "
                f"{ACTION_WIDTH}); use step_chunk for several actions of each environment"
            )
        return self.step_chunk(actions[:, np.newaxis])

    def step_chunk(
        self, actions: ArrayLike, render: Render = "last", *, expert: ArrayLike | None = None
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Executes control steps, actions [environments, steps, 7], until each rollout ends.

        With ``render="last"`` an environment's observation is the one after its last step; with
        ``"all"`` arrays are [environments, steps, …], and zero beyond the executed steps, which
        ``info["taken"]`` counts (0 for an environment that begins a rollout, whose first
        observation is at index 0; under ``SAME_STEP``, a new rollout's first observation takes the
        place of the ended rollout's last); with ``"none"`` there are no frames.

        ``expert``, [environments, steps], queries a scripted expert, which reads the simulator's
        state, at every step: ``info["expert_action"]``, [environments, steps, 7], has the expert's
        actions, NaN beyond the executed steps. At steps where ``expert`` is True, it drives: the
        given action is added to the arm's part of the expert's action, within -1..1.

        Under an execution model, or with ``execute``, ``actions`` are the answers to the
        observations of the previous call. Each environment runs until its next query is due, in
        ``info["taken"]`` steps; before an answer takes effect, it executes actions of earlier
        answers or holds still. ``info["delay"]`` counts the steps until the next answer takes
        effect, and with ``rtc`` ``info["under_way"]`` has the actions [n, 7] scheduled for the
        coming steps."""
        actions = np.asarray(actions, dtype=np.float64)
        missing = [at for at, rollout in enumerate(self.rollouts) if not rollout.is_begun]
        if missing:
            raise gymnasium.error.ResetNeeded(
                f"failed to step: rollouts {missing} were not begun; call reset"
            )
        over = [at for at, rollout in enumerate(self.rollouts) if rollout.is_over]
        if over and self.autoreset_mode != AutoresetMode.NEXT_STEP:
            raise gymnasium.error.ResetNeeded(
                f"failed to step: rollouts {over} have ended; call reset with "
                f"options={{'reset_mask': …}}"
            )
        starts = {at: self.starts[at].plan(self._generators[at], {}) for at in over}
        limits = [
            0 if rollout.is_over else rollout.max_steps - rollout.steps for rollout in self.rollouts
        ]
        actions, schedules = self._scheduled(actions, limits, expert is not None)
        advanced = self._batch.advance(
            actions,
            limits,
            self._rows(starts),
            self._cameras,
            render=render,
            absolute=self._absolute,
            mirrored=self._mirrored,
            expert=None if expert is None else np.asarray(expert, dtype=bool),
        )
        taken, success, errors = (
            advanced["steps"].astype(np.int64),
            advanced["success"],
            advanced["errors"],
        )
        self._begin(starts, errors)
        truncated = np.zeros(self.num_envs, bool)
        for at, rollout in enumerate(self.rollouts):
            if at not in starts:
                truncated[at] = rollout.advance(int(taken[at]), bool(success[at]), errors[at])
            if at in schedules and not isinstance(errors[at], UNTOUCHED):
                rollout.schedule = schedules[at]
        observation, infos = self._observation(advanced), self._infos(success)
        infos["taken"] = taken
        if expert is not None:
            infos["expert_action"] = advanced["expert_action"]
        ended = (success | truncated) & [error is None for error in errors]
        if self.autoreset_mode == AutoresetMode.SAME_STEP and ended.any():
            self._begin_same_step(ended, observation, infos, render, errors)
        result = observation, success.astype(np.float64), success, truncated, infos
        return self._finished(result, infos, errors)

    def foresee(self, steps: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Returns the actions that the scripted expert takes in the next steps if it drives from
        now on, [n, steps, 7], without changing the environments.

        Actions after the step that reaches the goal are NaN. The second array, [n], is False where
        the expert makes no progress: the hand is stuck, or retreats from where it was stuck."""
        return self._batch.foresee(steps)

    def _scheduled(
        self, actions: NDArray[np.float64], limits: list[int], is_expert: bool
    ) -> tuple[NDArray[np.float64], dict[int, native.Schedule]]:
        """Returns the actions [environments, steps, 7] until each environment's next query is due,
        and the schedules at that time; shortens ``limits`` to these steps. Changes no rollout."""
        with_schedule = [
            at
            for at, rollout in enumerate(self.rollouts)
            if rollout.schedule and not rollout.is_over
        ]
        if not with_schedule:
            return actions, {}
        if is_expert:
            raise ValueError(
                "failed to query the expert: it answers at every step, and with an execution model "
                "or `execute` a policy answers only when a query is due; make environments without "
                "either"
            )
        if actions.ndim != 3 or len(actions) != self.num_envs:
            raise ValueError(
                f"failed to step with actions of shape {actions.shape}: expected ({self.num_envs}, "
                f"steps, {ACTION_WIDTH})"
            )
        schedules, rows = {}, {at: actions[at] for at in range(self.num_envs)}
        for at in with_schedule:
            schedule: Any = self.rollouts[at].schedule
            schedules[at] = schedule.copy()
            schedules[at].answer(actions[at])
            rows[at] = schedules[at].until_due()
            limits[at] = min(limits[at], len(rows[at]))
        commands = np.zeros((self.num_envs, max(map(len, rows.values())), ACTION_WIDTH))
        for at, row in rows.items():
            limits[at] = min(limits[at], len(row))
            commands[at, : len(row)] = row
        return commands, schedules

    def set_perturbation(self, index: int, perturbation: Perturbation | None) -> None:
        """Changes an environment's perturbation, from its next rollout on. Raises ValueError if the
        task has no such configuration, or it does not fit the control or the execution model; the
        previous perturbation stays in effect."""
        self.starts[index].perturb(perturbation)

    def snapshot(self) -> VectorSnapshot:
        """Returns the complete state for the next step, without the generators that seed resets."""
        return VectorSnapshot(
            tuple(simulation.snapshot() for simulation in self.simulations),
            tuple(replace(rollout) for rollout in self.rollouts),
        )

    def restore(self, snapshot: VectorSnapshot) -> None:
        """Returns to a snapshot. Raises ValueError if the snapshot is of other tasks; no
        environment has changed then."""
        self._batch.restore(snapshot.simulations)
        self.rollouts = [replace(rollout) for rollout in snapshot.rollouts]

    def close_extras(self, **_kwargs: Any) -> None:
        """Frees the environments."""
        for simulation in self.simulations:
            simulation.close()

    def _begin_same_step(
        self,
        ended: NDArray[np.bool_],
        observation: Observation,
        infos: dict[str, Any],
        render: Render,
        errors: list[Exception | None],
    ) -> None:
        """Begins new rollouts in place of those that ended in this step."""
        indices = np.flatnonzero(ended).tolist()
        infos["final_obs"] = _rows_as_objects(observation, indices, self.num_envs)
        infos["_final_obs"] = ended
        final = {name: infos[name] for name in ("success", "init_state", "steps")}
        infos["final_info"] = {name: values.copy() for name, values in final.items()}
        infos["_final_info"] = ended
        starts = {at: self.starts[at].plan(self._generators[at], {}) for at in indices}
        batch = native.Batch([self.simulations[at] for at in indices], self._threads)
        advanced = batch.advance(
            np.empty((len(indices), 0, ACTION_WIDTH)),
            [0] * len(indices),
            [starts[at].row for at in indices],
            self._cameras,
            render="none" if render == "none" else "last",
            mirrored=self._mirrored,
        )
        for at, error in zip(indices, advanced["errors"], strict=True):
            errors[at] = error
        self._begin(starts, errors)
        begun = self._observation(advanced)
        for name, values in observation.items():
            if render == "all":
                values[indices, infos["taken"][indices] - 1] = begun[name]
            else:
                values[indices] = begun[name]
        infos.update(self._infos(infos["success"]))

    def _rows(self, starts: Mapping[int, Start]) -> list[str | None]:
        """Returns the manifest rows of the environments that begin a rollout; None for the
        others."""
        return [starts[at].row if at in starts else None for at in range(self.num_envs)]

    def _begin(self, starts: Mapping[int, Start], errors: Sequence[Exception | None]) -> None:
        """Records the rollouts that the simulator has begun. A start that failed counts as used,
        too, so that the next start differs."""
        for at, start in starts.items():
            error = errors[at]
            if isinstance(error, UNTOUCHED):
                continue
            self.starts[at].use(start)
            self._generators[at] = start.generator
            if error is None:
                self.rollouts[at].begin(start)
                self.rollouts[at].schedule = self._schedule(at, start)
            else:
                self.rollouts[at].is_over = True

    def _schedule(self, at: int, start: Start) -> native.Schedule | None:
        """Returns the schedule of a rollout; None if its chunks are executed as they are given."""
        if start.execution == "wait" and self._execute is None:
            return None
        state = start.init_state or 0
        task = self.tasks[at].name
        return native.Schedule(start.execution, task, state, execute=self._execute)

    def _finished(
        self, result: Any, infos: dict[str, Any], errors: Sequence[Exception | None]
    ) -> Any:
        """Returns the result of a call, or raises the first error with the result attached."""
        failed = [at for at, error in enumerate(errors) if error is not None]
        if not failed:
            return result
        infos["failed"] = np.array([error is not None for error in errors])
        error: Any = errors[failed[0]]
        error.environments, error.result = failed, result
        raise error

    def _observation(self, advanced: dict[str, Any]) -> Observation:
        return {name: advanced[name] for name in self._space if name in advanced}

    def _infos(self, success: NDArray[np.bool_]) -> dict[str, Any]:
        schedules = [rollout.schedule for rollout in self.rollouts]
        queries = [None if schedule is None else schedule.due() for schedule in schedules]
        query_infos: dict[str, Any] = {}
        if any(schedules):
            delays = [query[0] if query else 0 for query in queries]
            query_infos["delay"] = np.array(delays, np.int64)
        if any(schedule is not None and schedule.is_rtc for schedule in schedules):
            query_infos["under_way"] = np.full(self.num_envs, None, dtype=object)
            for at, query in enumerate(queries):
                query_infos["under_way"][at] = None if query is None else query[1]
        rollouts = self.rollouts
        return query_infos | {
            "success": success,
            "instruction": np.array([rollout.instruction for rollout in rollouts], dtype=object),
            "init_state": np.array([rollout.init_state for rollout in rollouts], dtype=object),
            "steps": np.array([rollout.steps for rollout in rollouts], np.int64),
        }


def _each(value: Any, count: int, name: str, kind: Any) -> list[Any]:
    """Returns a value for each environment: the given one for all, or those of a list."""
    if value is None or isinstance(value, kind):
        return [value] * count
    if len(value) != count:
        raise ValueError(
            f"failed to set {name} of {count} environments: {len(value)} were given; give one "
            f"{name}, or one for each environment"
        )
    return list(value)


def _rows_as_objects(
    observation: Observation, indices: Sequence[int], count: int
) -> NDArray[np.object_]:
    """Copies some environments' observations, in the form that gymnasium uses in an info."""
    rows = np.full(count, None, dtype=object)
    for at in indices:
        rows[at] = {name: values[at].copy() for name, values in observation.items()}
    return rows
