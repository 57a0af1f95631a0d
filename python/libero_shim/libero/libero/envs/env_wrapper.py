"""The environments that scripts construct."""

from __future__ import annotations

import os
from collections import OrderedDict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from libero.libero.envs import bddl_utils
from libero.libero.envs._construction import report_failure
from libero.libero.envs._robot import Robot
from libero.libero.envs._settings import controller_config, existing_file
from libero.libero.envs._sim import MjSim
from libero.libero.envs._simulation import ClosedError
from libero.libero.envs.bddl_base_domain import TASK_MAPPING, BDDLBaseDomain

Observation = OrderedDict[str, Any]

__all__ = ["ControlEnv", "DemoRenderEnv", "OffScreenRenderEnv", "SegmentationRenderEnv"]


class ControlEnv:
    """A task, controlled at 20 Hz. Frames have row 0 at the bottom."""

    def __init__(
        self,
        bddl_file_name: str | os.PathLike[str],
        robots: Any = ("Panda",),
        controller: str = "OSC_POSE",
        **arguments: Any,
    ) -> None:
        """Reads the task's BDDL file and compiles its scene, once for all environments of the
        scene. Takes LIBERO's and robosuite's further arguments by name, as `Settings.check` lists
        them: sizes of frames are in pixels, 128 by default, `horizon` is in steps. Raises
        FileNotFoundError for a missing file or missing assets, NotImplementedError for features
        that only LIBERO has, TypeError for an unknown argument."""
        cameras = {"camera_names": ("agentview", "robot0_eye_in_hand")}
        sizes = {"camera_heights": 128, "camera_widths": 128}
        arguments = {**cameras, **sizes, **arguments}
        with report_failure():
            self._construct(bddl_file_name, robots=robots, controller=controller, **arguments)

    def _construct(
        self, bddl_file_name: str | os.PathLike[str], *, controller: str, **arguments: Any
    ) -> None:
        file = existing_file(bddl_file_name)
        info = bddl_utils.get_problem_info(file)
        self.problem_name = info["problem_name"]
        self.domain_name = info["domain_name"]
        self.language_instruction = info["language_instruction"]
        problem = self._problem_class(self.problem_name)
        if problem is None:
            raise ValueError(
                f"{file} is of the problem `{self.problem_name}`: known are "
                f"{', '.join(TASK_MAPPING)}"
            )
        self._env: BDDLBaseDomain | None = problem(
            file, controller_configs=controller_config(controller), **arguments
        )

    @staticmethod
    def _problem_class(name: str) -> type[BDDLBaseDomain] | None:
        """Returns the class that simulates a problem; None if there is none."""
        return TASK_MAPPING.get(name)

    @property
    def env(self) -> BDDLBaseDomain:
        """The task's simulation. Raises ClosedError."""
        if self._env is None:
            raise ClosedError("the environment is closed: construct a new one to go on")
        return self._env

    @property
    def obj_of_interest(self) -> list[str]:
        """Names of the objects of interest for the task."""
        return self.env.obj_of_interest

    @property
    def robots(self) -> list[Robot]:
        """The robot, in a list. A reset makes a new one."""
        return self.env.robots

    @property
    def sim(self) -> MjSim:
        """State, names and arrays of the simulation."""
        return self.env.sim

    def step(self, action: Any) -> tuple[Observation, float, bool, dict[str, Any]]:
        return self.env.step(action)

    def reset(self) -> Observation:
        return self.env.reset()

    def seed(self, seed: int | None) -> None:
        """Seeds NumPy's global generator, which resets draw from."""
        self.env.seed(seed)

    def check_success(self) -> bool:
        """Returns True if the goal holds."""
        return self.env._check_success()

    def get_sim_state(self) -> NDArray[np.float64]:
        """The state [1 + nq + nv]: time, s, joint positions and velocities."""
        return self.sim.get_state().flatten()

    def set_state(self, mujoco_state: Any) -> None:
        """Writes a state without computing derived values."""
        self.sim.set_state_from_flattened(mujoco_state)

    def set_init_state(self, init_state: Any) -> Observation:
        return self.regenerate_obs_from_state(init_state)

    def regenerate_obs_from_state(self, mujoco_state: Any) -> Observation:
        self.set_state(mujoco_state)
        self.sim.forward()
        self.check_success()
        self._post_process()
        self._update_observables(force=True)
        return self.env._get_observations()

    def reset_from_xml_string(self, xml_string: str) -> None:
        """Not supported: raises NotImplementedError."""
        self.env.reset_from_xml_string(xml_string)

    def close(self) -> None:
        """Frees the simulation. Closing again does nothing."""
        if self._env is not None:
            self._env.close()
            self._env = None

    @property
    def _visualizations(self) -> set[str]:
        return self.env._visualizations

    def _post_process(self) -> None:
        self.env._post_process()

    def _update_observables(self, force: bool = False) -> None:
        self.env._update_observables(force=force)


class OffScreenRenderEnv(ControlEnv):
    """A task with frames of its cameras, for evaluation. Takes `ControlEnv`'s arguments by name."""

    def __init__(self, **kwargs: Any) -> None:
        kwargs["has_renderer"] = False
        kwargs["has_offscreen_renderer"] = True
        super().__init__(**kwargs)


class SegmentationRenderEnv(OffScreenRenderEnv):
    """A task whose cameras also label each pixel. In a segmentation by `instance`, `instance_to_id`
    has the labels of objects, fixtures and arm; larger labels are mount and gripper, 0 the room."""

    def __init__(
        self,
        camera_segmentations: Any = "instance",
        camera_heights: Any = 128,
        camera_widths: Any = 128,
        **kwargs: Any,
    ) -> None:
        if camera_segmentations is None:
            raise ValueError(
                "camera_segmentations is the kind of the pixels' labels: give 'instance', "
                "'class' or 'element'"
            )
        super().__init__(
            camera_segmentations=camera_segmentations,
            camera_heights=camera_heights,
            camera_widths=camera_widths,
            **kwargs,
        )
        self.segmentation_id_mapping: dict[int, str] = {}
        self.instance_to_id: dict[str, int] = {}
        self.segmentation_robot_id: int | None = None

    def reset(self) -> Observation:
        """See `BDDLBaseDomain.reset`; numbers the instances."""
        observation = super().reset()
        for i, instance in enumerate(self.env.model.instances_to_ids):
            if instance.endswith("Panda0"):
                self.segmentation_robot_id = i
            if instance not in ("RethinkMount0", "PandaGripper0"):
                self.segmentation_id_mapping[i] = instance
        self.instance_to_id = {
            instance: i + 1 for i, instance in self.segmentation_id_mapping.items()
        }
        return observation

    def get_segmentation_instances(
        self, segmentation_image: NDArray[np.int32]
    ) -> dict[str, NDArray[np.int32]]:
        """Splits a segmentation into one array for each instance, which is 0 outside the
        instance's pixels. Arm, mount and gripper are the instance `robot`."""
        if self.segmentation_robot_id is None:
            raise RuntimeError("instances are numbered by reset: call it first")
        robot = self.segmentation_robot_id + 1
        merged = np.minimum(segmentation_image, robot)
        parts = {"robot": merged * (merged == robot)}
        for i, instance in self.segmentation_id_mapping.items():
            parts[instance] = merged * (merged == i + 1)
        return parts

    def get_segmentation_of_interest(
        self, segmentation_image: NDArray[np.int32]
    ) -> NDArray[np.int32]:
        """Returns 1 at objects of interest, -1 at the room, 0 elsewhere."""
        interest = np.zeros_like(segmentation_image)
        for instance in self.obj_of_interest:
            # An object of interest may be a part, such as a drawer, which has no number.
            if instance in self.instance_to_id:
                interest[segmentation_image == self.instance_to_id[instance]] = 1
        interest[segmentation_image == 0] = -1
        return interest


class DemoRenderEnv(OffScreenRenderEnv):
    """A task with frames of its cameras, for replaying demonstrations."""

    def _get_observations(self) -> Observation:
        return self.env._get_observations()
