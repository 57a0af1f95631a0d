"""LIBERO-Plus' suites: all variants of LIBERO's forty tasks, and `libero_90` unchanged."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from typing import Any

import liberoplus.liberoplus as _core
from libero.libero import benchmark as _libero
from libero.libero.benchmark import Task
from libero.libero.benchmark.init_states import load_init_states
from libero.libero.benchmark.registry import Registry, suite_class
from libero.libero.envs.bddl_utils import get_problem_info
from liberoplus.liberoplus.files import UNCHANGED
from rollout_libero._native import PlusPath, PlusVariant

__all__ = [
    "BENCHMARK_MAPPING",
    "Benchmark",
    "Task",
    "get_benchmark",
    "get_benchmark_dict",
    "grab_language_from_filename",
    "libero_suites",
    "libero_task_map",
    "print_benchmark",
    "register_benchmark",
    "task_maps",
]

libero_suites = list(_libero.libero_suites)
#: Names of the variants by suite (of LIBERO's tasks in `libero_90`), in the benchmark's order.
libero_task_map: dict[str, list[str]] = {
    suite: [variant.name for variant in PlusVariant.of_suite(suite)]
    if suite != UNCHANGED
    else list(_libero.libero_task_map[suite])
    for suite in libero_suites
}


def grab_language_from_filename(suite_name: str, x: str) -> str:
    """Returns the prompt of the variant with this file name: the words of the name, including the
    description of the change. If the change is of the instruction, returns the instruction in the
    BDDL file, in lower case.

    Raises FileNotFoundError if the task files cannot be fetched."""
    variant = PlusVariant.find(os.path.splitext(x)[0])
    if variant is None:
        return _libero.grab_language_from_filename(x)
    if not variant.has_own_sentence:
        return variant.prompt("")
    file = PlusPath(os.path.join(_core.get_libero_path("bddl_files"), suite_name, x)).file
    return variant.prompt(get_problem_info(file)["language_instruction"])


class _TaskMaps(Mapping[str, dict[str, Task]]):
    """Tasks by suite and name. The tasks of a suite are created at its first use, because some
    prompts are in BDDL files, which may have to be fetched."""

    def __init__(self) -> None:
        self._created: dict[str, dict[str, Task]] = {}

    def __getitem__(self, suite: str) -> dict[str, Task]:
        if suite not in self._created:
            self._created[suite] = {name: _task(suite, name) for name in libero_task_map[suite]}
        return self._created[suite]

    def __iter__(self) -> Iterator[str]:
        return iter(libero_suites)

    def __len__(self) -> int:
        return len(libero_suites)


def _task(suite: str, name: str) -> Task:
    return Task(
        name=name,
        language=grab_language_from_filename(suite, f"{name}.bddl"),
        problem="Libero",
        problem_folder=suite,
        bddl_file=f"{name}.bddl",
        init_states_file=f"{name}.pruned_init",
    )


task_maps: Mapping[str, dict[str, Task]] = _TaskMaps()


class Benchmark(_libero.Benchmark):
    """A suite. The path that `get_task_bddl_file_path` returns need not exist: the environments
    parse the changes in the path's file name, and open the BDDL file to which they apply."""

    _task_maps = task_maps

    def __init__(self, task_order_index: int = 0) -> None:
        if task_order_index != 0:
            raise ValueError(
                "LIBERO-Plus draws its further orders of tasks anew in each process: leave "
                "task_order_index at 0, and shuffle the indices with a seed of your own"
            )
        super().__init__(task_order_index)

    @staticmethod
    def _path(key: str) -> str:
        return _core.get_libero_path(key)

    def get_task_init_states(self, i: int) -> Any:
        """A variant's initial states: a float64 array [states, 1 + nq + nv] of time, s, and joint
        positions and velocities. A variant that changes the objects' layout has one state; every
        other variant has LIBERO's fifty states.

        Raises FileNotFoundError for tasks of libero_90, for which LIBERO-Plus has no states."""
        name = self.tasks[i].name
        variant = PlusVariant.find(name)
        if variant is None:
            raise FileNotFoundError(
                f"LIBERO-Plus has no initial states for {name} of {self.name}: take LIBERO's, from "
                "libero.libero.benchmark"
            )
        states = load_init_states(os.path.join(self._path("init_states"), variant.states_file))
        return states.reshape(1, -1) if variant.has_one_state else states


_registry = Registry[Benchmark]()
BENCHMARK_MAPPING = _registry.suites
register_benchmark = _registry.register
get_benchmark_dict = _registry.listed
get_benchmark = _registry.find
print_benchmark = _registry.print

for _name in libero_suites:
    register_benchmark(suite_class(Benchmark, _name))
