"""A gymnasium environment for one task."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import Any, Literal, cast

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from rollout_libero.configuration import InitStates, Perturbation
from rollout_libero.observation import ACTION_WIDTH, CAMERAS, Observation, Orientation, Render
from rollout_libero.vector import VectorEnvironment, VectorSnapshot


class Environment(gymnasium.Env[Observation, NDArray[np.float32]]):
    """A task of LIBERO.

    Args:
        task: ``libero_spatial/0`` to ``libero_10/9``.
        assets: ``"libero"``, which is the default and fetched at first use, a LIBERO assets
            folder, or ``"primitives"``; see ``rollout_libero.files``.
        cameras: cameras of the frames.
        height, width: size of the frames, pixels.
        orientation: orientation of the frames: ``"policy"``, LIBERO's arrays rotated by 180° as
            VLAs were trained on them, or ``"upright"``, as a person sees the scene; see
            ``observation.Orientation``.
        init_states: initial states of rollouts; see ``configuration.InitStates``.
        settle_steps: control steps without action before the first observation, in which
            objects come to rest; by default those of the configuration
            (``num_steps_wait``), 10 in LIBERO-CTRL.
        max_steps: control steps after which a rollout is truncated; by default those of the
            configuration (``max_steps``), in LIBERO-CTRL the suite's.
        perturbation: a configuration of LIBERO-CTRL, ``simultaneous/L2/c03``, a row of a manifest,
            or a ``Capsule``. It includes the instruction and, unless ``init_states="sampled"``, the
            initial state; a capsule always has its own state.
        control: ``"relative"`` (displacements, -1..1) or ``"absolute"`` (poses in the world
            frame: m, and axis times angle, rad), which cannot be combined with the actuation
            axis.
        renderer: ``"software"``; ``"gl"`` for OpenGL, or ``"gl:N"`` for OpenGL on device N, from
            0. Each thread that renders opens an OpenGL context of its own.
        look: how texture files are read: ``"mujoco-3.3.2"``, as LIBERO's demonstrations were drawn,
            or ``"mujoco-3.3.3"``, as MuJoCo draws them since; by default ``$ROLLOUT_LOOK``, else
            the first.

    The reward is 1 in the successful step, which ends the rollout, and 0 in all other steps.
    ``info`` has ``success``, ``instruction``, ``init_state`` and ``steps``. Raises ValueError for
    an unknown task or camera, or an invalid value; FileNotFoundError if files are missing; the
    message has the remedy."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(
        self,
        task: str,
        assets: str | PathLike[str] | None = None,
        *,
        cameras: Sequence[str] = CAMERAS,
        height: int = 256,
        width: int = 256,
        orientation: Orientation = "policy",
        init_states: InitStates = "cycle",
        settle_steps: int | None = None,
        max_steps: int | None = None,
        perturbation: Perturbation | None = None,
        control: Literal["relative", "absolute"] = "relative",
        renderer: str = "software",
        look: str | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._envs = VectorEnvironment(
            task,
            1,
            assets,
            threads=1,
            cameras=cameras,
            height=height,
            width=width,
            orientation=orientation,
            init_states=init_states,
            settle_steps=settle_steps,
            max_steps=max_steps,
            perturbation=perturbation,
            control=control,
            renderer=renderer,
            look=look,
            autoreset_mode=AutoresetMode.DISABLED,
        )
        (self.task,), (self.simulation,) = self._envs.tasks, self._envs.simulations
        self.scene = self.simulation.scene
        if (execution := self._envs.starts[0].execution) != "wait":
            raise ValueError(
                f"failed to make an environment under execution model {execution!r}: Environment "
                "executes actions without delay; use VectorEnvironment, or Schedule"
            )
        self.observation_space = cast(
            "gymnasium.Space[Observation]", self._envs.single_observation_space
        )
        self.action_space = cast(
            "gymnasium.Space[NDArray[np.float32]]", self._envs.single_action_space
        )
        self.render_mode = render_mode
        self._camera = (cameras[0], width, height) if cameras else (CAMERAS[0], 256, 256)
        known = self.simulation.names("camera")
        for camera in cameras:
            if camera not in known:
                raise ValueError(f"failed to use camera `{camera}`: the scene has {known}")

    @property
    def instruction(self) -> str:
        """The policy's instruction."""
        return self._envs.rollouts[0].instruction

    @property
    def max_steps(self) -> int:
        """Control steps after which the rollout is truncated."""
        return self._envs.rollouts[0].max_steps

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins a rollout, up to the policy's first action.

        A seed selects the rollout's start. With ``init_states="cycle"`` it selects initial state
        ``seed % 50``, as each task has 50; with numbers, the number at index ``seed %
        len(numbers)``; later resets without a seed continue from there in turn. ``"random"`` and
        ``"sampled"`` draw from a generator with this seed. ``options={"init_state": 7}`` takes
        precedence, and a configuration's own initial state does not depend on the seed."""
        observation, infos = self._envs.reset(seed=[seed], options=options)
        super().reset(seed=seed)
        return {name: values[0] for name, values in observation.items()}, _info(infos)

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Executes a control step, 50 ms, with seven numbers: translation, rotation, gripper."""
        action = np.asarray(action, dtype=np.float64)
        if action.shape != (ACTION_WIDTH,):
            raise ValueError(
                f"failed to step with an action of shape {action.shape}: expected "
                f"{ACTION_WIDTH} numbers, three of translation, three of rotation and the gripper; "
                "use step_chunk for several actions"
            )
        return self.step_chunk(action[np.newaxis])

    def step_chunk(
        self, actions: ArrayLike, render: Render = "last"
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Executes control steps with the actions, [steps, 7], until the rollout ends.

        With ``render="last"`` the observation is the one after the last step; with ``"all"`` its
        arrays have the executed steps as their first axis; with ``"none"`` it has no frames.
        ``info["steps"]`` counts the steps since the reset.

        A call that raises ``ValueError`` for its arguments has changed nothing. After
        ``SimulationError`` the rollout is over: call ``reset``."""
        rollout = self._envs.rollouts[0]
        if not rollout.is_begun or rollout.is_over:
            raise gymnasium.error.ResetNeeded(
                "failed to step: the rollout has ended, or none was begun; call reset"
            )
        actions = np.asarray(actions, dtype=np.float64)
        if actions.ndim != 2 or not len(actions):
            raise ValueError(
                f"failed to step with actions of shape {actions.shape}: expected [steps, 7]"
            )
        result = self._envs.step_chunk(actions[np.newaxis], render)
        observation, rewards, terminated, truncated, infos = result
        observation = {name: values[0] for name, values in observation.items()}
        if render == "all":
            taken = infos["taken"][0]
            observation = {name: values[:taken] for name, values in observation.items()}
        ended = bool(terminated[0]), bool(truncated[0])
        return observation, float(rewards[0]), *ended, _info(infos)

    def render(self) -> NDArray[np.uint8] | None:
        """Returns the first camera's view in the mode ``rgb_array``, always
        upright, for any orientation of the observations."""
        if self.render_mode is None:
            return None
        return self.simulation.frame(*self._camera)[::-1]

    def snapshot(self) -> VectorSnapshot:
        """Returns all that determines the next step, but not what later resets draw from."""
        return self._envs.snapshot()

    def restore(self, snapshot: VectorSnapshot) -> None:
        """Returns to a snapshot of an environment of the same task and assets."""
        self._envs.restore(snapshot)

    def close(self) -> None:
        """Frees the environment; later calls raise ``ClosedError``."""
        self.simulation.close()


def _info(infos: dict[str, Any]) -> dict[str, Any]:
    """Returns an environment's own values of the infos of a vector environment."""
    return {
        "success": bool(infos["success"][0]),
        "instruction": infos["instruction"][0],
        "init_state": infos["init_state"][0],
        "steps": int(infos["steps"][0]),
    }
