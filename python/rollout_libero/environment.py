"""One environment, as gymnasium has it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rollout_libero._library import native
from rollout_libero.configuration import InitStates, Starts
from rollout_libero.observation import (
    ACTION_WIDTH,
    CAMERAS,
    Observation,
    action_space,
    observation_space,
)
from rollout_libero.scenes import scene_of_task
from rollout_libero.tasks import Task

Render = Literal["last", "all", "none"]


class EnvironmentSnapshot(NamedTuple):
    """All that an environment's next step depends on."""

    simulation: native.Snapshot
    steps: int
    ended: bool
    init_state: int | None


class Environment(gymnasium.Env[Observation, NDArray[np.float32]]):
    """A task of LIBERO.

    Args:
        task: ``libero_spatial/0`` to ``libero_10/9``.
        assets: ``"libero"``, which is the default and fetched at first use, a LIBERO assets
            folder, or ``"primitives"``; see ``rollout_libero.files``.
        cameras: of whom frames are drawn.
        height, width: of the frames, pixels.
        init_states: where rollouts begin; see ``configuration.InitStates``.
        settle_steps: control steps without action before the first observation, in which
            objects come to rest.
        max_steps: control steps after which a rollout is truncated; by default those of
            LIBERO-CTRL for the suite.
        perturbation: a configuration of LIBERO-CTRL, ``combination/L2/c03``, or a row of a
            manifest. It brings its instruction and, unless ``init_states="sampled"``, its
            initial state.
        control: ``"relative"`` (displacements, -1..1) or ``"absolute"`` (poses in the world:
            m, and axis times angle, rad).
        renderer: ``"software"``; ``"gl"`` or ``"gl:N"`` for OpenGL, which ties the
            environment's frames to the thread that draws them.

    The reward is 1 in the step that succeeds, which ends the rollout, and 0 before.
    ``info`` has ``success``, ``instruction``, ``init_state`` and ``steps``.

    Raises:
        ValueError: for a task, camera or value that does not exist.
        FileNotFoundError: if files are missing; the message has the remedy.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(
        self,
        task: str,
        assets: str | PathLike[str] | None = None,
        *,
        cameras: Sequence[str] = CAMERAS,
        height: int = 256,
        width: int = 256,
        init_states: InitStates = "cycle",
        settle_steps: int = 10,
        max_steps: int | None = None,
        perturbation: str | Mapping[str, Any] | None = None,
        control: Literal["relative", "absolute"] = "relative",
        renderer: str = "software",
        render_mode: str | None = None,
    ) -> None:
        self.task = Task.of(task)
        self.scene = scene_of_task(self.task, assets)
        self.simulation = native.Simulation(self.scene, renderer=renderer)
        self.max_steps = self.task.max_steps if max_steps is None else max_steps
        self.starts = Starts(
            self.task, self.scene.initial_states, init_states, settle_steps, perturbation
        )
        self.observation_space = observation_space(cameras, height, width)
        self.action_space = action_space()
        self.render_mode = render_mode
        self._cameras = [(camera, width, height) for camera in cameras]
        self._batch = native.Batch([self.simulation], 1)
        self._absolute = is_absolute(control)
        self._steps = 0
        self._ended = True
        self._init_state: int | None = None
        known = self.simulation.names("camera")
        for camera in cameras:
            if camera not in known:
                raise ValueError(f"look through camera `{camera}`: the scene has {known}")

    @property
    def instruction(self) -> str:
        """What a policy is told."""
        return self.starts.instruction

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins a rollout, up to its policy's first action.

        ``options`` may have ``init_state``: the number of a released initial state. A seed
        also starts the turns of ``init_states`` over.
        """
        super().reset(seed=seed)
        if seed is not None:
            self.starts.restart()
        start, self._init_state = self.starts.next(self.np_random, options or {})
        none = np.empty((1, 0, ACTION_WIDTH))
        shown = self._batch.advance(none, [0], [start], self._cameras)
        self._steps, self._ended = 0, False
        return self._observation(shown), self._info(success=False)

    def step(
        self, action: ArrayLike
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One control step, 50 ms, with seven numbers: translation, rotation, gripper."""
        action = np.asarray(action, dtype=np.float64)
        if action.shape != (ACTION_WIDTH,):
            raise ValueError(
                f"step with an action of shape {action.shape}: it has {ACTION_WIDTH} numbers, three "
                "of translation, three of rotation and the gripper; use step_chunk for several"
            )
        return self.step_chunk(action[np.newaxis])

    def step_chunk(
        self, actions: ArrayLike, render: Render = "last"
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Control steps with the actions, [steps, 7], as far as the rollout goes.

        With ``render="last"`` the observation is that after the last step, with ``"all"``
        its arrays have a first axis of the steps taken, and with ``"none"`` there are no
        frames. ``info["steps"]`` counts the steps since the reset.
        """
        if self._ended:
            raise gymnasium.error.ResetNeeded(
                "step: the rollout has ended, or none was begun; call reset"
            )
        actions = np.asarray(actions, dtype=np.float64)
        if actions.ndim != 2 or not len(actions):
            raise ValueError(f"step with actions of shape {actions.shape}: expected [steps, 7]")
        limit = self.max_steps - self._steps
        shown = self._batch.advance(
            actions[np.newaxis],
            [limit],
            [None],
            self._cameras,
            render=render,
            absolute=self._absolute,
        )
        taken, success = int(shown["steps"][0]), bool(shown["success"][0])
        self._steps += taken
        truncated = not success and self._steps >= self.max_steps
        self._ended = success or truncated
        observation = self._observation(shown)
        if render == "all":
            observation = {name: values[:taken] for name, values in observation.items()}
        return observation, float(success), success, truncated, self._info(success=success)

    def render(self) -> NDArray[np.uint8] | None:
        """What the first camera sees, upright, in the mode ``rgb_array``."""
        if self.render_mode is None:
            return None
        camera, width, height = (self._cameras or [(CAMERAS[0], 256, 256)])[0]
        return self.simulation.frame(camera, width, height)[::-1]

    def snapshot(self) -> EnvironmentSnapshot:
        """All that the next step depends on; the generator that seeds resets is left out."""
        return EnvironmentSnapshot(
            self.simulation.snapshot(), self._steps, self._ended, self._init_state
        )

    def restore(self, snapshot: EnvironmentSnapshot) -> None:
        """Goes back to a snapshot of an environment of the same task and assets."""
        self.simulation.restore(snapshot.simulation)
        _, self._steps, self._ended, self._init_state = snapshot

    def close(self) -> None:
        """Frees it; later calls raise ``ClosedError``."""
        self.simulation.close()

    def _observation(self, shown: dict[str, Any]) -> Observation:
        return {name: shown[name][0] for name in self.observation_space if name in shown}

    def _info(self, *, success: bool) -> dict[str, Any]:
        return {
            "success": success,
            "instruction": self.instruction,
            "init_state": self._init_state,
            "steps": self._steps,
        }


def is_absolute(control: str) -> bool:
    """Whether actions are poses."""
    if control not in ("relative", "absolute"):
        raise ValueError(f"choose control {control!r}: it is 'relative' or 'absolute'")
    return control == "absolute"
