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
    """An object or fixture, with its names in the model, including collision geoms."""

    name: str
    category_name: str
    root_body: str
    joints: list[str]
    contact_geoms: list[str]
    visual_geoms: list[str]

    @property
    def naming_prefix(self) -> str:
        """The prefix of its parts' names."""
        return f"{self.name}_"

    def __getattr__(self, name: str) -> Any:
        raise absent_attribute(
            f"the object {self.__dict__.get('name', '')}", name, "it has names only; ask env.sim"
        )


class TaskModel:
    """The geoms and sites of each instance and class, in robosuite's order:
    objects, fixtures, arm, mount, gripper."""

    def __init__(self, scene: Scene, model: MjModel, arm: str, mount: str) -> None:
        trees = _Trees(model)
        self._counts = {"geom": model.ngeom, "site": model.nsite}
        self.objects = {
            name: trees.object(name, category, scene.root_body(name), scene.joints(name))
            for name, category in scene.objects
        }
        self.fixtures = {
            name: trees.object(name, category, scene.root_body(name), scene.joints(name))
            for name, category in scene.fixtures
        }
        self.mujoco_objects = [*self.objects.values(), *self.fixtures.values()]
        parts = [
            (each.name, _class_of(each.category_name), trees.of_prefix(each.naming_prefix))
            for each in self.mujoco_objects
        ] + [
            (f"{arm}0", arm, trees.of_prefix("robot0_")),
            (f"{mount}0", mount, trees.of_prefix("mount0_")),
            ("PandaGripper0", "PandaGripper", trees.of_prefix("gripper0_")),
        ]
        self.instances_to_ids: dict[str, dict[str, list[int]]] = {}
        self.classes_to_ids: dict[str, dict[str, list[int]]] = {}
        self.geom_ids_to_instances: dict[int, str] = {}
        self.geom_ids_to_classes: dict[int, str] = {}
        self.site_ids_to_instances: dict[int, str] = {}
        self.site_ids_to_classes: dict[int, str] = {}
        for instance, of_class, ids in parts:
            self.instances_to_ids[instance] = ids
            group = self.classes_to_ids.setdefault(of_class, {"geom": [], "site": []})
            for kind, instances, classes in (
                ("geom", self.geom_ids_to_instances, self.geom_ids_to_classes),
                ("site", self.site_ids_to_instances, self.site_ids_to_classes),
            ):
                group[kind] += ids[kind]
                instances.update(dict.fromkeys(ids[kind], instance))
                classes.update(dict.fromkeys(ids[kind], of_class))

    def numbers(self, kind: str) -> dict[str, NDArray[np.int32]]:
        """Returns the numbers of the geoms and sites, by id. With `kind` `instance`, all parts of
        an instance have its number, with `class` that of its class, counted from 1; parts of the
        room have 0."""
        groups = self.instances_to_ids if kind == "instance" else self.classes_to_ids
        numbers = {part: np.zeros(count, dtype=np.int32) for part, count in self._counts.items()}
        for i, ids in enumerate(groups.values()):
            for part, of_id in numbers.items():
                of_id[ids[part]] = i + 1
        return numbers

    def __getattr__(self, name: str) -> Any:
        raise absent_attribute(
            "the task's model", name, "it knows instances and their ids; ask env.sim otherwise"
        )


class _Trees:
    """The body that each geom and site is attached to, and thus its part of the scene."""

    def __init__(self, model: MjModel) -> None:
        bodies = model.body_names
        self.owners = {
            "geom": [bodies[i] or "" for i in model.geom_bodyid],
            "site": [bodies[i] or "" for i in model.site_bodyid],
        }
        self.geoms = model.geom_names
        # Group 0 collides, group 1 is drawn.
        self.groups = model.geom_group

    def of_prefix(self, prefix: str) -> dict[str, list[int]]:
        """Returns ids of the geoms and sites of the bodies with this name prefix."""
        return {kind: list(self._ids(kind, prefix)) for kind in self.owners}

    def object(self, name: str, category: str, root: str, joints: list[str]) -> ObjectModel:
        ids = list(self._ids("geom", f"{name}_"))
        named = {0: [], 1: []}  # type: dict[int, list[str]]
        for i in ids:
            if self.geoms[i] is not None:
                named.setdefault(int(self.groups[i]), []).append(self.geoms[i])
        return ObjectModel(name, category, root, joints, named[0], named[1])

    def _ids(self, kind: str, prefix: str) -> Iterator[int]:
        return (i for i, body in enumerate(self.owners[kind]) if body.startswith(prefix))


def _class_of(category: str) -> str:
    return "".join(word.capitalize() for word in category.split("_"))
