"""The suites: their tasks, the order of the tasks, and the initial states."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from libero.libero.benchmark.init_states import load_init_states
from libero.libero.benchmark.libero_suite_task_map import libero_task_map, task_orders
from libero.libero.benchmark.registry import Registry, suite_class
from libero.libero.paths import get_libero_path

__all__ = [
    "BENCHMARK_MAPPING", "Benchmark", "Task", "get_benchmark", "get_benchmark_dict",
    "grab_language_from_filename", "libero_suites", "libero_task_map", "print_benchmark",
    "register_benchmark", "task_maps", "task_orders",
]  # fmt: skip


class Task(NamedTuple):
    """A task of a suite. File names are relative to the suite's folder."""

    name: str
    language: str
    problem: str
    problem_folder: str
    bddl_file: str
    init_states_file: str


def grab_language_from_filename(x: str) -> str:
    """Returns the instruction spelled by a task's file name, without the scene before it."""
    name = os.path.splitext(x)[0]
    return re.sub(r"^[A-Z].*?SCENE\d+_", "", name).replace("_", " ")


libero_suites = list(libero_task_map)
#: Tasks by suite and name, in the benchmark's own order.
task_maps: dict[str, dict[str, Task]] = {
    suite: {
        name: Task(
            name=name,
            language=grab_language_from_filename(f"{name}.bddl"),
            problem="Libero",
            problem_folder=suite,
            bddl_file=f"{name}.bddl",
            init_states_file=f"{name}.pruned_init",
        )
        for name in names
    }
    for suite, names in libero_task_map.items()
}


class Benchmark:
    """A suite. `task_order_index` selects one of 21 orders of a suite of ten tasks."""

    name: str
    tasks: list[Task]
    n_tasks: int
    _task_maps: Mapping[str, Mapping[str, Task]] = task_maps

    def __init__(self, task_order_index: int = 0) -> None:
        self.task_embs: Any = None
        self.task_order_index = task_order_index

    @staticmethod
    def _path(key: str) -> str:
        return get_libero_path(key)

    def _make_benchmark(self) -> None:
        tasks = list(self._task_maps[self.name].values())
        if len(tasks) == 10:
            tasks = [tasks[i] for i in task_orders[self.task_order_index]]
        self.tasks = tasks
        self.n_tasks = len(tasks)

    def get_num_tasks(self) -> int:
        return self.n_tasks

    def get_task_names(self) -> list[str]:
        return [task.name for task in self.tasks]

    def get_task_problems(self) -> list[str]:
        """The problem name of each task, which is always `Libero`."""
        return [task.problem for task in self.tasks]

    def get_task_bddl_files(self) -> list[str]:
        return [task.bddl_file for task in self.tasks]

    def get_task_bddl_file_path(self, i: int) -> str:
        task = self.tasks[i]
        return os.path.join(self._path("bddl_files"), task.problem_folder, task.bddl_file)

    def get_task_demonstration(self, i: int) -> str:
        """Returns the path of a task's demonstrations, relative to the folder `datasets`."""
        if not 0 <= i < self.n_tasks:
            raise IndexError(f"{self.name} has no task {i}: its tasks are 0 to {self.n_tasks - 1}")
        return f"{self.tasks[i].problem_folder}/{self.tasks[i].name}_demo.hdf5"

    def get_task(self, i: int) -> Task:
        return self.tasks[i]

    def get_task_emb(self, i: int) -> Any:
        """Returns the embedding that `set_task_embs` was given for a task."""
        return self.task_embs[i]

    def get_task_init_states(self, i: int) -> Any:
        """A task's initial states: a float64 array [states, 1 + nq + nv] of time, s, and
        joint positions and velocities."""
        task = self.tasks[i]
        root = self._path("init_states")
        return load_init_states(os.path.join(root, task.problem_folder, task.init_states_file))

    def set_task_embs(self, task_embs: Any) -> None:
        """Stores embeddings of the instructions, one per task."""
        self.task_embs = task_embs


_registry = Registry[Benchmark]()
BENCHMARK_MAPPING = _registry.suites
register_benchmark = _registry.register
get_benchmark_dict = _registry.listed
get_benchmark = _registry.find
print_benchmark = _registry.print


def _suite(suite: str) -> type[Benchmark]:
    return register_benchmark(suite_class(Benchmark, suite))


LIBERO_SPATIAL = _suite("libero_spatial")
LIBERO_OBJECT = _suite("libero_object")
LIBERO_GOAL = _suite("libero_goal")
LIBERO_90 = _suite("libero_90")
LIBERO_10 = _suite("libero_10")


@register_benchmark
class LIBERO_100(Benchmark):
    """libero_90 and libero_10 together. It has no files of its own, and cannot
    be constructed in LIBERO itself either."""

    def __init__(self, task_order_index: int = 0) -> None:
        raise KeyError(
            "libero_100 has no task files: construct libero_90 and libero_10, which it consists of"
        )
