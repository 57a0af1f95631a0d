"""Observations, with robosuite's keys in robosuite's order."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from libero.libero.envs._lazy import Observation, Undrawn
from libero.libero.envs._models import TaskModel
from libero.libero.envs._rotations import relative_poses
from libero.libero.envs._settings import Camera
from libero.libero.envs._simulation import SimulationHandle
from rollout_libero._native import CapturedView, Scene

_ROBOT = "robot0"
#: MuJoCo's object type numbers.
_GEOM, _SITE = 5, 6
_PROPRIOCEPTION = (
    "joint_pos", "joint_pos_cos", "joint_pos_sin", "joint_vel", "eef_pos", "eef_quat",
    "gripper_qpos", "gripper_qvel",
)  # fmt: skip

__all__ = ["Observation", "Observer"]

#: For each scene, the sets of cameras through which this process has drawn it.
_drawn: WeakKeyDictionary[Scene, set[tuple[Camera, ...]]] = WeakKeyDictionary()


class Observer:
    """Reads the simulation's last observation once, and draws only those of its pictures that are
    accessed."""

    def __init__(
        self,
        handle: SimulationHandle,
        cameras: tuple[Camera, ...],
        model: TaskModel,
        unused: Collection[str] = (),
    ) -> None:
        """Frames of `unused` cameras are zeros and are never rendered."""
        self._handle = handle
        self._objects = [(each.name, each.root_body) for each in model.objects.values()]
        self._pictures: dict[str, Callable[[CapturedView], NDArray[Any]]] = {}
        for camera in cameras:
            self._add(camera, model, is_used=camera.name not in unused)
        proprioception = [f"{_ROBOT}_{name}" for name in _PROPRIOCEPTION]
        poses = [
            f"{name}_{key}"
            for name, _ in self._objects
            for key in ("pos", "quat", f"to_{_ROBOT}_eef_pos", f"to_{_ROBOT}_eef_quat")
        ]
        #: Key → modality. The values of a modality, except images, are also joined to one vector.
        self.modalities: dict[str, str] = {
            **dict.fromkeys(proprioception, f"{_ROBOT}_proprio"),
            **dict.fromkeys(self._pictures, "image"),
            **dict.fromkeys(poses, "object"),
        }
        self._left_out: set[str] = set()
        self._undrawn: dict[str, Undrawn] = {}
        self._view: CapturedView | None = None
        self._cameras = tuple(camera for camera in cameras if camera.name not in unused)
        self._read: dict[str, NDArray[Any]] = {}

    @property
    def names(self) -> list[str]:
        """Keys of the readings and pictures in observations, without the joined vectors."""
        return [name for name in self.modalities if name not in self._left_out]

    def include(self, name: str, included: bool) -> None:
        """Includes a key in observations or leaves it out. Omitted pictures are not drawn. Raises
        KeyError for an unknown key."""
        if name not in self.modalities:
            raise KeyError(
                f"there is no observation `{name}`; there are {', '.join(self.modalities)}"
            )
        (self._left_out.discard if included else self._left_out.add)(name)

    def expire(self) -> None:
        """Discards cached values after the simulation has made a new observation."""
        self._undrawn = {}
        self._view = None
        self._read = {}

    def observe(self) -> Observation:
        """Returns readings, frames, and the vectors that join readings of one modality. The first
        observation of a scene through these cameras is drawn at once, so that drawing errors
        appear early."""
        if not self._read:
            self._read = self._readings()
        observation = Observation()
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
        drawn = _drawn.setdefault(self._handle.scene, set())
        if self._cameras not in drawn:
            observation.draw()
            drawn.add(self._cameras)
        return observation

    def _readings(self) -> dict[str, NDArray[Any]]:
        simulation = self._handle.get()
        readings = simulation.readings()
        for name in ("pos", "vel"):
            readings[f"gripper_q{name}"] = readings.pop(f"gripper_{name}")
        readings["joint_pos_cos"] = np.cos(readings["joint_pos"])
        readings["joint_pos_sin"] = np.sin(readings["joint_pos"])
        read = {f"{_ROBOT}_{name}": readings[name] for name in _PROPRIOCEPTION}
        poses = [simulation.body_pose(body) for _, body in self._objects]
        if poses:
            positions, quaternions = map(np.array, zip(*poses))
            relative = relative_poses(
                positions, quaternions, readings["eef_pos"], readings["eef_quat"]
            )
            for (name, _), pose, from_hand in zip(self._objects, poses, zip(*relative)):
                read[f"{name}_pos"], read[f"{name}_quat"] = pose
                (read[f"{name}_to_{_ROBOT}_eef_pos"], read[f"{name}_to_{_ROBOT}_eef_quat"]) = (
                    from_hand
                )
        return read

    def _picture(self, name: str) -> Undrawn:
        """Returns the placeholder of a picture of the current state, which is drawn when it is
        first read. All observations of this state share the placeholder."""
        if self._view is None:
            self._view = self._handle.get().capture()
        if name not in self._undrawn:
            self._undrawn[name] = Undrawn(partial(self._pictures[name], self._view))
        return self._undrawn[name]

    def _add(self, camera: Camera, model: TaskModel, *, is_used: bool) -> None:
        name, width, height = camera.name, camera.width, camera.height
        image, depth = f"{name}_image", f"{name}_depth"
        segmentations = {kind: f"{name}_segmentation_{kind}" for kind in camera.segmentations}
        if not is_used:
            self._pictures[image] = lambda view: np.zeros((height, width, 3), np.uint8)
            if camera.depth:
                self._pictures[depth] = lambda view: np.zeros((height, width, 1), np.float32)
            for key in segmentations.values():
                self._pictures[key] = lambda view: np.zeros((height, width, 1), np.int32)
            return
        self._pictures[image] = lambda view: view.frame(name, width, height)
        if camera.depth:
            self._pictures[depth] = lambda view: view.depth(name, width, height)[..., np.newaxis]
        for kind, key in segmentations.items():
            self._pictures[key] = _segmentation(camera, kind, model)


def _segmentation(
    camera: Camera, kind: str, model: TaskModel
) -> Callable[[CapturedView], NDArray[np.int32]]:
    def segments(view: CapturedView) -> NDArray[np.int32]:
        return view.segmentation(camera.name, camera.width, camera.height)

    if kind == "element":
        return lambda view: _geoms(segments(view))
    numbers = model.numbers(kind)

    def draw(view: CapturedView) -> NDArray[np.int32]:
        types_and_ids = segments(view)
        labels = np.zeros((*types_and_ids.shape[:2], 1), dtype=np.int32)
        for part, object_type in (("geom", _GEOM), ("site", _SITE)):
            pixels = types_and_ids[..., 0] == object_type
            labels[pixels, 0] = numbers[part][types_and_ids[pixels, 1]]
        return labels

    return draw


def _geoms(segments: NDArray[np.int32]) -> NDArray[np.int32]:
    """Returns the id of each pixel's geom, [h, w, 1]; -1 for a pixel that shows no geom."""
    ids = np.where(segments[..., 0] == _GEOM, segments[..., 1], np.int32(-1))
    return ids[..., np.newaxis]
