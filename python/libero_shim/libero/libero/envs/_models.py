"""The parts of a scene, as robosuite's task model shows them: instances and their ids."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from libero._absent import absent_attribute
from libero.libero.envs._sim import MjModel
from rollout_libero._native import Scene


@dataclass(frozen=True)
class ObjectModel:
    """An object or fixture, with the names of its parts in the model."""

    name: str
    category_name: str
    root_body: str
    joints: list[str]
    contact_geoms: list[str]
    visual_geoms: list[str]

    @property
    def naming_prefix(self) -> str:
        """The prefix of the names of the object's parts."""
        return f"{self.name}_"

    def __getattr__(self, name: str) -> Any:
        raise absent_attribute(
            f"the object {self.__dict__.get('name', '')}", name, "it has names only; ask env.sim"
        )


class TaskModel:
    """The geoms and sites of each instance and class, in robosuite's order:
    objects, fixtures, arm, mount, gripper."""

    def __init__(self, scene: Scene, model: MjModel, arm: str, mount: str) -> None:
        parts_of_bodies = _PartsOfBodies(model)
        self._counts = {"geom": model.ngeom, "site": model.nsite}
        self.objects = {
            name: parts_of_bodies.object(name, category, scene.root_body(name), scene.joints(name))
            for name, category in scene.objects
        }
        self.fixtures = {
            name: parts_of_bodies.object(name, category, scene.root_body(name), scene.joints(name))
            for name, category in scene.fixtures
        }
        self.mujoco_objects = [*self.objects.values(), *self.fixtures.values()]
        parts = [
            (
                each.name,
                _class_of(each.category_name),
                parts_of_bodies.ids_of_prefix(each.naming_prefix),
            )
            for each in self.mujoco_objects
        ] + [
            (f"{arm}0", arm, parts_of_bodies.ids_of_prefix("robot0_")),
            (f"{mount}0", mount, parts_of_bodies.ids_of_prefix("mount0_")),
            ("PandaGripper0", "PandaGripper", parts_of_bodies.ids_of_prefix("gripper0_")),
        ]
        self.instances_to_ids: dict[str, dict[str, list[int]]] = {}
        self.classes_to_ids: dict[str, dict[str, list[int]]] = {}
        self.geom_ids_to_instances: dict[int, str] = {}
        self.geom_ids_to_classes: dict[int, str] = {}
        self.site_ids_to_instances: dict[int, str] = {}
        self.site_ids_to_classes: dict[int, str] = {}
        for instance, class_name, ids in parts:
            self.instances_to_ids[instance] = ids
            group = self.classes_to_ids.setdefault(class_name, {"geom": [], "site": []})
            for kind, instances, classes in (
                ("geom", self.geom_ids_to_instances, self.geom_ids_to_classes),
                ("site", self.site_ids_to_instances, self.site_ids_to_classes),
            ):
                group[kind] += ids[kind]
                instances.update(dict.fromkeys(ids[kind], instance))
                classes.update(dict.fromkeys(ids[kind], class_name))

    def numbers(self, kind: str) -> dict[str, NDArray[np.int32]]:
        """Returns the segmentation numbers of all geoms and of all sites, by id. If `kind` is
        `instance`, a geom or site has the number of its instance; if it is `class`, the number of
        its instance's class. Both count from 1, and the room has 0."""
        groups = self.instances_to_ids if kind == "instance" else self.classes_to_ids
        numbers = {part: np.zeros(count, dtype=np.int32) for part, count in self._counts.items()}
        for i, ids in enumerate(groups.values()):
            for part, numbers_by_id in numbers.items():
                numbers_by_id[ids[part]] = i + 1
        return numbers

    def __getattr__(self, name: str) -> Any:
        raise absent_attribute(
            "the task's model", name, "it knows instances and their ids; ask env.sim otherwise"
        )


class _PartsOfBodies:
    """The geoms and sites of each body. The prefix of a body's name tells its instance."""

    def __init__(self, model: MjModel) -> None:
        bodies = model.body_names
        self.owners = {
            "geom": [bodies[i] or "" for i in model.geom_bodyid],
            "site": [bodies[i] or "" for i in model.site_bodyid],
        }
        self.geoms = model.geom_names
        # Geoms of group 0 collide, and geoms of group 1 are drawn.
        self.groups = model.geom_group

    def ids_of_prefix(self, prefix: str) -> dict[str, list[int]]:
        """Returns the ids of the geoms and of the sites of all bodies with this name prefix."""
        return {kind: list(self._ids(kind, prefix)) for kind in self.owners}

    def object(self, name: str, category: str, root: str, joints: list[str]) -> ObjectModel:
        ids = list(self._ids("geom", f"{name}_"))
        names_by_group = {0: [], 1: []}  # type: dict[int, list[str]]
        for i in ids:
            if self.geoms[i] is not None:
                names_by_group.setdefault(int(self.groups[i]), []).append(self.geoms[i])
        return ObjectModel(name, category, root, joints, names_by_group[0], names_by_group[1])

    def _ids(self, kind: str, prefix: str) -> Iterator[int]:
        return (i for i, body in enumerate(self.owners[kind]) if body.startswith(prefix))


def _class_of(category: str) -> str:
    return "".join(word.capitalize() for word in category.split("_"))
