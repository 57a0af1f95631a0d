"""Many environments in one process, as gymnasium has them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Literal, NamedTuple

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from rollout_libero._library import native
from rollout_libero.configuration import InitStates, Starts
from rollout_libero.environment import Render, is_absolute
from rollout_libero.observation import (
    ACTION_WIDTH,
    CAMERAS,
    Observation,
    action_space,
    observation_space,
)
from rollout_libero.scenes import scene_of_task
from rollout_libero.tasks import Task


class VectorSnapshot(NamedTuple):
    """All that the environments' next step depends on."""

    simulations: tuple[native.Snapshot, ...]
    steps: NDArray[np.int64]
    ended: NDArray[np.bool_]
    init_states: tuple[int | None, ...]


class VectorEnvironment(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Environments that step together, on threads of this process.

    Environments of one task share its compiled scene. Frames, readings, rewards and ends
    are stacked, one row for each environment.

    Args:
        tasks: one task, or several; environment *i* has the *i*-th, and they repeat.
        num_envs: how many environments; by default one of each task.
        threads: on how many threads they compute; by default as many as there are cores.
            With OpenGL it is one.
        perturbation: one for all, or one for each environment.
        autoreset_mode: as gymnasium 1.x defines it: ``NEXT_STEP`` begins a rollout in the
            step after the last, whose action is ignored; ``SAME_STEP`` at once, with the
            last observation in ``info["final_obs"]``; ``DISABLED`` not at all: reset with
            ``options={"reset_mask": …}``.

    What else there is to say is said of ``Environment``.
    """

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
        init_states: InitStates = "random",
        settle_steps: int = 10,
        max_steps: int | None = None,
        perturbation: str | Mapping[str, Any] | Sequence[str | Mapping[str, Any] | None] | None = None,
        control: Literal["relative", "absolute"] = "relative",
        renderer: str = "software",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        names = [tasks] if isinstance(tasks, str) else list(tasks)
        self.num_envs = len(names) if num_envs is None else num_envs
        if not names or self.num_envs < 1:
            raise ValueError("make environments: give one task at least, and num_envs from 1")
        self.tasks = [Task.of(names[at % len(names)]) for at in range(self.num_envs)]
        scenes = [scene_of_task(task, assets) for task in self.tasks]
        self.simulations = [native.Simulation(scene, renderer=renderer) for scene in scenes]
        self.starts = [
            Starts(task, scene.initial_states, init_states, settle_steps, perturbed)
            for task, scene, perturbed in zip(
                self.tasks, scenes, _each(perturbation, self.num_envs), strict=True
            )
        ]
        self.max_steps = np.array([max_steps or task.max_steps for task in self.tasks])
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"autoreset_mode": self.autoreset_mode}
        self.single_observation_space = observation_space(cameras, height, width)
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._cameras = [(camera, width, height) for camera in cameras]
        self._threads = threads or len(os.sched_getaffinity(0))
        self._batch = native.Batch(self.simulations, self._threads)
        self._absolute = is_absolute(control)
        self._generators = [seeding.np_random()[0] for _ in self.tasks]
        self._steps = np.zeros(self.num_envs, np.int64)
        self._begun = np.zeros(self.num_envs, bool)
        self._ended = np.zeros(self.num_envs, bool)
        self._init_states: list[int | None] = [None] * self.num_envs

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins rollouts.

        A number seeds environment *i* with itself plus *i*. ``options`` may have
        ``reset_mask``, [environments], of those that begin, and ``init_state``, a number or
        one for each.
        """
        options = dict(options or {})
        mask = np.asarray(options.pop("reset_mask", np.ones(self.num_envs, bool)), dtype=bool)
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"reset with a mask of shape {mask.shape}: expected ({self.num_envs},), one True at least"
            )
        for at, number in enumerate(_seeds(seed, self.num_envs)):
            if number is not None and mask[at]:
                self._generators[at] = seeding.np_random(number)[0]
                self.starts[at].restart()
        chosen = np.broadcast_to(options.get("init_state"), self.num_envs)
        starts = self._starts(mask, [{"init_state": it} for it in chosen])
        shown = self._batch.advance(self._no_actions(), [0] * self.num_envs, starts, self._cameras)
        return self._observation(shown), self._infos(np.zeros(self.num_envs, bool))

    def step(
        self, actions: ArrayLike
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """One control step of each environment, with actions [environments, 7]."""
        actions = np.asarray(actions, dtype=np.float64)
        if actions.shape != (self.num_envs, ACTION_WIDTH):
            raise ValueError(
                f"step with actions of shape {actions.shape}: expected ({self.num_envs}, "
                f"{ACTION_WIDTH}); use step_chunk for several of each"
            )
        return self.step_chunk(actions[:, np.newaxis])

    def step_chunk(
        self,
        actions: ArrayLike,
        render: Render = "last",
        *,
        expert: ArrayLike | None = None,
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Control steps with actions [environments, steps, 7], each rollout as far as it goes.

        With ``render="last"`` an environment's observation is that after its last step; with
        ``"all"`` arrays are [environments, steps, …], and zero beyond the steps taken, which
        ``info["taken"]`` counts (where a rollout begins, none, and the first observation is
        in the first place); with ``"none"`` there are no frames.

        ``expert``, [environments, steps], has a scripted expert asked at every step, which
        looks at the simulator's state: ``info["expert_action"]``, [environments, steps, 7],
        is what it would do there, NaN beyond the steps taken. Where ``expert`` is true it
        drives, and ``actions`` are added to its own.
        """
        actions = np.asarray(actions, dtype=np.float64)
        if not self._begun.all():
            raise gymnasium.error.ResetNeeded("step: no rollout was begun; call reset")
        begins = self._ended.copy()
        if begins.any() and self.autoreset_mode != AutoresetMode.NEXT_STEP:
            which = np.flatnonzero(begins).tolist()
            raise gymnasium.error.ResetNeeded(
                f"step: rollouts {which} have ended; call reset with options={{'reset_mask': …}}"
            )
        starts = self._starts(begins, [{}] * self.num_envs)
        limits = np.where(begins, 0, self.max_steps - self._steps)
        shown = self._batch.advance(
            actions,
            limits.tolist(),
            starts,
            self._cameras,
            render=render,
            absolute=self._absolute,
            expert=None if expert is None else np.asarray(expert, dtype=bool),
        )
        taken, success = shown["steps"].astype(np.int64), shown["success"]
        self._steps += taken
        truncated = ~begins & ~success & (self._steps >= self.max_steps)
        self._ended = success | truncated
        ended = self._ended.copy()
        observation, infos = self._observation(shown), self._infos(success)
        infos["taken"] = taken
        if expert is not None:
            infos["expert_action"] = shown["expert_action"]
        if self.autoreset_mode == AutoresetMode.SAME_STEP and ended.any():
            self._begin_at_once(ended, observation, infos)
        return observation, success.astype(np.float64), success, truncated, infos

    def set_perturbation(self, index: int, perturbation: str | Mapping[str, Any] | None) -> None:
        """Perturbs an environment otherwise, from its next rollout on."""
        self.starts[index].perturb(perturbation)

    def snapshot(self) -> VectorSnapshot:
        """All that the next step depends on; the generators that seed resets are left out."""
        return VectorSnapshot(
            tuple(simulation.snapshot() for simulation in self.simulations),
            self._steps.copy(),
            self._ended.copy(),
            tuple(self._init_states),
        )

    def restore(self, snapshot: VectorSnapshot) -> None:
        """Goes back to a snapshot."""
        for simulation, state in zip(self.simulations, snapshot.simulations, strict=True):
            simulation.restore(state)
        self._steps[:], self._ended[:] = snapshot.steps, snapshot.ended
        self._init_states = list(snapshot.init_states)
        self._begun[:] = True

    def close_extras(self, **_kwargs: Any) -> None:
        """Frees the environments."""
        for simulation in self.simulations:
            simulation.close()

    def _begin_at_once(
        self, ended: NDArray[np.bool_], observation: Observation, infos: dict[str, Any]
    ) -> None:
        """Begins rollouts in the place of those that ended in this step."""
        which = np.flatnonzero(ended)
        infos["final_obs"] = _rows_as_objects(observation, which, self.num_envs)
        infos["_final_obs"] = ended
        final = {name: infos[name] for name in ("success", "init_state", "steps")}
        infos["final_info"] = {name: values.copy() for name, values in final.items()}
        infos["_final_info"] = ended
        starts = self._starts(ended, [{}] * self.num_envs)
        batch = native.Batch([self.simulations[at] for at in which], self._threads)
        shown = batch.advance(
            np.empty((len(which), 0, ACTION_WIDTH)),
            [0] * len(which),
            [starts[at] for at in which],
            self._cameras,
        )
        begun = self._observation(shown)
        for name, values in observation.items():
            last = values[:, -1] if values.ndim > begun[name].ndim else values
            last[which] = begun[name]
        infos.update(self._infos(infos["success"]))

    def _starts(
        self, mask: NDArray[np.bool_], options: Sequence[Mapping[str, Any]]
    ) -> list[str | None]:
        starts: list[str | None] = [None] * self.num_envs
        for at in np.flatnonzero(mask):
            generator = self._generators[at]
            starts[at], self._init_states[at] = self.starts[at].next(generator, options[at])
        self._steps[mask], self._ended[mask], self._begun[mask] = 0, False, True
        return starts

    def _no_actions(self) -> NDArray[np.float64]:
        return np.empty((self.num_envs, 0, ACTION_WIDTH))

    def _observation(self, shown: dict[str, Any]) -> Observation:
        return {name: shown[name] for name in self.single_observation_space if name in shown}

    def _infos(self, success: NDArray[np.bool_]) -> dict[str, Any]:
        return {
            "success": success,
            "instruction": np.array([it.instruction for it in self.starts], dtype=object),
            "init_state": np.array(self._init_states, dtype=object),
            "steps": self._steps.copy(),
        }


def _each(perturbation: Any, count: int) -> list[Any]:
    if perturbation is None or isinstance(perturbation, str | Mapping):
        return [perturbation] * count
    if len(perturbation) != count:
        raise ValueError(f"perturb {count} environments: {len(perturbation)} were given")
    return list(perturbation)


def _seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    if seed is None:
        return [None] * count
    if isinstance(seed, int | np.integer):
        return [int(seed) + at for at in range(count)]
    if len(seed) != count:
        raise ValueError(f"seed {count} environments: {len(seed)} seeds were given")
    return list(seed)


def _rows_as_objects(
    observation: Observation, which: NDArray[np.int64], count: int
) -> NDArray[np.object_]:
    """Copies of some environments' observations, as gymnasium has them in an info."""
    rows = np.full(count, None, dtype=object)
    for at in which:
        rows[at] = {name: values[at].copy() for name, values in observation.items()}
    return rows
