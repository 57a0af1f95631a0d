"""What is observed, with robosuite's keys in robosuite's order."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from libero.libero.envs._models import TaskModel
from libero.libero.envs._rotations import relative_poses
from libero.libero.envs._settings import Camera
from libero.libero.envs._sim import shown_geoms
from libero.libero.envs._simulation import Held

_ROBOT = "robot0"
_PROPRIOCEPTION = (
    "joint_pos",
    "joint_pos_cos",
    "joint_pos_sin",
    "joint_vel",
    "eef_pos",
    "eef_quat",
    "gripper_qpos",
    "gripper_qvel",
)

Observation = OrderedDict[str, Any]


class Observer:
    """Reads and draws what the simulation observed last, once for each observation."""

    def __init__(self, held: Held, cameras: tuple[Camera, ...], model: TaskModel) -> None:
        self._held = held
        self._objects = [(one.name, one.root_body) for one in model.objects.values()]
        self._pictures: dict[str, Callable[[], NDArray[Any]]] = {}
        for camera in cameras:
            self._add(camera, model)
        proprioception = [f"{_ROBOT}_{name}" for name in _PROPRIOCEPTION]
        poses = [
            f"{name}_{what}"
            for name, _ in self._objects
            for what in ("pos", "quat", f"to_{_ROBOT}_eef_pos", f"to_{_ROBOT}_eef_quat")
        ]
        #: Key → the joint vector that its values are part of, if any.
        self.modalities: dict[str, str] = {
            **dict.fromkeys(proprioception, f"{_ROBOT}_proprio"),
            **dict.fromkeys(self._pictures, "image"),
            **dict.fromkeys(poses, "object"),
        }
        self._left_out: set[str] = set()
        self._drawn: dict[str, NDArray[Any]] = {}
        self._read: dict[str, NDArray[Any]] = {}

    @property
    def names(self) -> list[str]:
        """Keys that are observed."""
        return [name for name in self.modalities if name not in self._left_out]

    def show(self, name: str, shown: bool) -> None:
        """Puts a key into observations, or leaves it out. What is left out is not drawn.

        Raises KeyError.
        """
        if name not in self.modalities:
            raise KeyError(
                f"nothing is observed as `{name}`: there are {', '.join(self.modalities)}"
            )
        (self._left_out.discard if shown else self._left_out.add)(name)

    def expire(self) -> None:
        """Says that the simulation has observed anew."""
        self._drawn = {}
        self._read = {}

    def observe(self) -> Observation:
        """Readings, frames, and the vectors that join readings of one kind."""
        if not self._read:
            self._read = self._readings()
        observation: Observation = OrderedDict()
        joined: dict[str, list[NDArray[Any]]] = {}
        for name in self.names:
            modality = self.modalities[name]
            if modality == "image":
                observation[name] = self._picture(name)
            else:
                observation[name] = self._read[name]
                joined.setdefault(f"{modality}-state", []).append(self._read[name])
        for name, parts in joined.items():
            observation[name] = np.concatenate(parts)
        return observation

    def _readings(self) -> dict[str, NDArray[Any]]:
        simulation = self._held.get()
        readings = simulation.readings()
        readings["joint_pos_cos"] = np.cos(readings["joint_pos"])
        readings["joint_pos_sin"] = np.sin(readings["joint_pos"])
        read = {f"{_ROBOT}_{name}": readings[name] for name in _PROPRIOCEPTION}
        poses = [simulation.body_pose(body) for _, body in self._objects]
        if poses:
            positions, quaternions = map(np.array, zip(*poses))
            seen = relative_poses(positions, quaternions, readings["eef_pos"], readings["eef_quat"])
            for (name, _), pose, from_hand in zip(self._objects, poses, zip(*seen)):
                read[f"{name}_pos"], read[f"{name}_quat"] = pose
                (
                    read[f"{name}_to_{_ROBOT}_eef_pos"],
                    read[f"{name}_to_{_ROBOT}_eef_quat"],
                ) = from_hand
        return read

    def _picture(self, name: str) -> NDArray[Any]:
        if name not in self._drawn:
            self._drawn[name] = self._pictures[name]()
        return self._drawn[name]

    def _add(self, camera: Camera, model: TaskModel) -> None:
        name, width, height = camera.name, camera.width, camera.height
        get = self._held.get
        self._pictures[f"{name}_image"] = lambda: get().frame(name, width, height)
        if camera.depth:
            self._pictures[f"{name}_depth"] = lambda: get().depth(name, width, height)[
                ..., np.newaxis
            ]
        for kind in camera.segmentations:
            self._pictures[f"{name}_segmentation_{kind}"] = self._segmentation(camera, kind, model)

    def _segmentation(
        self, camera: Camera, kind: str, model: TaskModel
    ) -> Callable[[], NDArray[np.int32]]:
        if kind == "instance":
            groups, of_geom = model.instances_to_ids, model.geom_ids_to_instances
        else:
            groups, of_geom = model.classes_to_ids, model.geom_ids_to_classes
        # 0 is what belongs to none; the last row stands for id -1, where nothing is.
        numbers = {group: i + 1 for i, group in enumerate(groups)}
        table = np.zeros(max(of_geom, default=0) + 2, dtype=np.int32)
        for geom, group in of_geom.items():
            table[geom] = numbers[group]

        def draw() -> NDArray[np.int32]:
            drawn = self._held.get().segmentation(camera.name, camera.width, camera.height)
            geoms = shown_geoms(drawn)[..., np.newaxis]
            if kind == "element":
                return geoms
            return table[np.where(geoms < len(table) - 1, geoms, -1)]

        return draw
