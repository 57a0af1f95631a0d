"""A task's simulation, which LIBERO's wrappers hold as `env.env`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from libero._absent import absent_attribute
from libero.libero.envs import bddl_utils
from libero.libero.envs._models import ObjectModel, TaskModel
from libero.libero.envs._observation import Observation, Observer
from libero.libero.envs._robot import Robot
from libero.libero.envs._settings import Settings, existing_file
from libero.libero.envs._sim import MjSim
from libero.libero.envs._simulation import SimulationHandle
from libero.libero.envs._unused import unused_cameras
from rollout_libero._native import PlusPath

F64 = NDArray[np.float64]

#: Classes that simulate the problems, by the problem's name.
TASK_MAPPING: dict[str, type[BDDLBaseDomain]] = {}


class BDDLBaseDomain:
    """A task of a BDDL file, in robosuite's interface."""

    #: True if the arm stands on a mount, False if it stands on the ground.
    mounted: ClassVar[bool]

    action_dim = 7
    control_freq = 20
    control_timestep = 0.05
    model_timestep = 0.002
    has_renderer = False
    viewer = None

    def __init__(
        self,
        bddl_file_name: str | os.PathLike[str],
        robots: Any = ("Panda",),
        change: PlusPath | None = None,
        look: str | None = None,
        **arguments: Any,
    ) -> None:
        """Takes robosuite's arguments. Some of them permit only the default; see `Settings.check`.
        `change` holds the posture and the view of a variant of LIBERO-Plus. `look` is
        "mujoco-3.3.2", as LIBERO's demonstrations were drawn, or "mujoco-3.3.3", as MuJoCo draws
        since; by default `$ROLLOUT_LOOK`, else the first.

        Draws placements from NumPy's global generator, as LIBERO does. `reset` returns the first
        observation. Raises FileNotFoundError for a missing file or missing assets, and the
        exceptions of `Settings.check`."""
        self.bddl_file_name = existing_file(bddl_file_name)
        settings = Settings.check(robots=robots, **arguments)
        self.parsed_problem = bddl_utils.robosuite_parse_problem(self.bddl_file_name)
        problem = self.parsed_problem["problem_name"]
        if problem != type(self).__name__.lower():
            raise ValueError(
                f"{self.bddl_file_name} is of the problem {problem}, not "
                f"{type(self).__name__}: take the class from TASK_MAPPING[{problem!r}]"
            )
        self._settings = settings
        self.horizon = settings.horizon
        self.ignore_done = settings.ignore_done
        self.hard_reset = settings.hard_reset
        self.reward_scale = settings.reward_scale
        self.has_offscreen_renderer = settings.has_offscreen_renderer
        self.use_camera_obs = bool(settings.cameras)
        self.camera_names = [camera.name for camera in settings.cameras]
        self.camera_heights = [camera.height for camera in settings.cameras]
        self.camera_widths = [camera.width for camera in settings.cameras]

        self._change = change
        self._handle = SimulationHandle(self.bddl_file_name, change, look)
        self.sim = MjSim(self._handle)
        # Raises for a camera that the scene lacks.
        for name in self.camera_names:
            self.sim.model.camera_name2id(name)
        arm, mount = (
            ("MountedPanda", "RethinkMount") if self.mounted else ("OnTheGroundPanda", "NullMount")
        )
        self._arm = arm
        self.model = TaskModel(self._handle.scene, self.sim.model, arm, mount)
        self.objects_dict = self.model.objects
        self.fixtures_dict = self.model.fixtures
        self.objects = list(self.objects_dict.values())
        self.fixtures = list(self.fixtures_dict.values())
        self.obj_body_id = {
            each.name: self.sim.model.body_name2id(each.root_body)
            for each in self.model.mujoco_objects
        }
        self.obj_of_interest: list[str] = self.parsed_problem["obj_of_interest"]
        #: Cameras whose frames are black.
        self.unused_cameras = unused_cameras(self.sim.model.camera_names)
        self._observer = Observer(self._handle, settings.cameras, self.model, self.unused_cameras)
        #: Control steps since the reset; `done` is True once they reach the horizon, unless
        #: `ignore_done` is set.
        self.timestep = 0
        self.done = False
        self._model_loads = 1
        self._start_over(hard=True)

    def seed(self, seed: int | None) -> None:
        """Seeds NumPy's global generator, which resets draw from."""
        np.random.seed(seed)

    def reset(self) -> Observation:
        """Resets all placements and returns the observation.

        With `hard_reset` LIBERO loads its model again, which lengthens its list of samplers for
        doors and knobs and so changes later draws. This method counts these loads, and draws the
        same numbers."""
        if self.hard_reset:
            self._model_loads += 1
        self._start_over(hard=self.hard_reset)
        return self._get_observations()

    def step(self, action: Any) -> tuple[Observation, float, bool, dict[str, Any]]:
        """One control step of 50 ms with 7 numbers: pose, and gripper (−1 opens, 1 closes).

        Returns the observation, the reward, True if the goal holds, and an empty dictionary. Raises
        ValueError for an invalid action, or if the episode is over."""
        simulation = self._handle.get()
        if self.done:
            raise ValueError(
                f"executing action in terminated episode: it had {self.horizon} steps; call "
                "reset, or construct the environment with a larger horizon or ignore_done=True"
            )
        absolute = not self.robots[0].controller.use_delta
        success = simulation.step(_checked(action), absolute=absolute)
        self._observer.expire()
        self.timestep += 1
        self.cur_time += self.control_timestep
        self.done = self.timestep >= self.horizon and not self.ignore_done
        return self._get_observations(), self._scaled(success), success, {}

    def reward(self, action: Any = None) -> float:
        """1 if the goal holds, else 0; times `reward_scale`."""
        return self._scaled(self._check_success())

    def close(self) -> None:
        self._handle.close()

    @property
    def action_spec(self) -> tuple[F64, F64]:
        """Least and largest actions [7]."""
        return self.robots[0].action_limits

    @property
    def language_instruction(self) -> str:
        """The instruction, in lower case."""
        return " ".join(self.parsed_problem["language_instruction"])

    @property
    def observation_names(self) -> set[str]:
        """Returns all available keys of observations."""
        return set(self._observer.modalities)

    @property
    def observation_modalities(self) -> set[str]:
        """The modalities of the available keys."""
        return set(self._observer.modalities.values())

    @property
    def active_observables(self) -> set[str]:
        """Returns the keys that observations contain."""
        return set(self._observer.names)

    enabled_observables = active_observables

    def observation_spec(self) -> Observation:
        return self._get_observations()

    def modify_observable(self, observable_name: str, attribute: str, modifier: Any) -> None:
        """Leaves a key out of observations or includes it again: `attribute` is `active` or
        `enabled`, `modifier` true or false. Frames that are left out are not drawn."""
        if attribute not in ("active", "enabled"):
            raise NotImplementedError(
                f"the {attribute} of an observable cannot be modified: `active` and `enabled` can; "
                "change what step returns instead"
            )
        self._observer.include(observable_name, bool(modifier))

    def get_object(self, object_name: str) -> ObjectModel | None:
        """Returns an object or fixture by name; None if there is none."""
        return self.fixtures_dict.get(object_name) or self.objects_dict.get(object_name)

    def is_fixture(self, object_name: str) -> bool:
        return object_name in self.fixtures_dict

    def get_robot_state_vector(self, obs: Observation) -> F64:
        """Concatenates fingers [2], end-effector position [3] and quaternion x y z w [4]."""
        return np.concatenate(
            [obs["robot0_gripper_qpos"], obs["robot0_eef_pos"], obs["robot0_eef_quat"]]
        )

    def check_contact(self, geoms_1: Any, geoms_2: Any = None) -> bool:
        """Returns True if a geom of the first group touches one of the second group or, without a
        second group, anything. A group is a name, several names, or an object."""
        first = _geoms(geoms_1)
        second = None if geoms_2 is None else _geoms(geoms_2)
        names = self.sim.model.geom_names
        for contact in self._handle.get().contacts():
            geoms = [names[geom] for geom in contact]
            for a, b in (geoms, geoms[::-1]):
                if a in first and (second is None or b in second):
                    return True
        return False

    def reset_from_xml_string(self, xml_string: str) -> None:
        """Not supported: raises NotImplementedError."""
        raise NotImplementedError(
            "a model cannot be loaded from MJCF: construct the environment from the task's "
            "BDDL file and set its state, as in set_init_state(states[0])"
        )

    def _check_success(self) -> bool:
        return self._handle.get().success()

    def _eval_predicate(self, state: Sequence[str]) -> bool:
        return self._handle.get().predicate(list(state))

    def _post_process(self) -> None:
        self._handle.get().post_process()

    def _update_observables(self, force: bool = False) -> None:
        if not force:
            raise NotImplementedError(
                "observables are updated by steps: give force=True to observe the current state"
            )
        self._handle.get().observe_now()
        self._observer.expire()

    def _get_observations(self, force_update: bool = False) -> Observation:
        if force_update:
            self._update_observables(force=True)
        return self._observer.observe()

    @property
    def _eef_xpos(self) -> F64:
        return self.sim.data.site_xpos[self.robots[0].eef_site_id]

    @property
    def _visualizations(self) -> set[str]:
        return {"env", "robots", "grippers"}

    def __getattr__(self, name: str) -> Any:
        raise absent_attribute(
            type(self).__name__, name, "ask its sim, robots, get_object or parsed_problem"
        )

    def _start_over(self, *, hard: bool) -> None:
        self._model_loads = self._handle.start_over(self._model_loads, hard=hard)
        self._observer.expire()
        posture = None if self._change is None else self._change.posture
        self.robots = [Robot(self._arm, self._handle, self.sim, self._settings.use_delta, posture)]
        self.timestep = 0
        self.cur_time = 0.0
        self.done = False

    def _scaled(self, success: bool) -> float:
        scale = 1.0 if self.reward_scale is None else self.reward_scale
        return float(success) * scale


def register_problem(target_class: type[BDDLBaseDomain]) -> type[BDDLBaseDomain]:
    """Registers a problem under its class's name, in lower case."""
    TASK_MAPPING[target_class.__name__.lower()] = target_class
    return target_class


def _define_problem(name: str, *, mounted: bool) -> None:
    members = {"mounted": mounted, "__module__": __name__, "__doc__": f"The problem {name}."}
    register_problem(type(name, (BDDLBaseDomain,), members))


_define_problem("Libero_Coffee_Table_Manipulation", mounted=False)
_define_problem("Libero_Floor_Manipulation", mounted=False)
_define_problem("Libero_Kitchen_Tabletop_Manipulation", mounted=True)
_define_problem("Libero_Living_Room_Tabletop_Manipulation", mounted=False)
_define_problem("Libero_Study_Tabletop_Manipulation", mounted=True)
_define_problem("Libero_Tabletop_Manipulation", mounted=True)


def _checked(action: Any) -> F64:
    checked = np.ascontiguousarray(action, dtype=np.float64)
    if checked.shape != (BDDLBaseDomain.action_dim,):
        raise ValueError(
            f"an action has 7 numbers, this one has the shape {checked.shape}: give three of "
            "translation, three of rotation, and the gripper"
        )
    return checked


def _geoms(names_or_object: Any) -> set[str]:
    if isinstance(names_or_object, str):
        return {names_or_object}
    return set(getattr(names_or_object, "contact_geoms", names_or_object))
