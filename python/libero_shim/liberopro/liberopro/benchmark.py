"""LIBERO's suites, and LIBERO-PRO's by their names: `libero_goal_swap`."""

from __future__ import annotations

import os
from typing import Any

import liberopro.liberopro as _core
from libero.libero import benchmark as _libero
from libero.libero.benchmark import (
    Task,
    grab_language_from_filename,
    libero_task_map,
    load_init_states,
    task_orders,
)
from liberopro.liberopro.files import SUITES

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
    "task_orders",
]

libero_suites = list(_libero.libero_suites)
#: Suite → name of the task → task, in the benchmark's own order.
task_maps: dict[str, dict[str, Task]] = {
    **_libero.task_maps,
    **{
        suite: {
            name: task._replace(problem_folder=suite)
            for name, task in _libero.task_maps[suite.rpartition("_")[0]].items()
        }
        for suite in SUITES
    },
}


class Benchmark(_libero.Benchmark):
    """A suite. Instructions are those of the tasks' names, as in LIBERO-PRO's own code: the
    sentence of a `_lan` or `_task` suite is in its BDDL file."""

    def _make_benchmark(self) -> None:
        tasks = list(task_maps[self.name].values())
        if len(tasks) == 10:
            tasks = [tasks[i] for i in task_orders[self.task_order_index]]
        self.tasks = tasks
        self.n_tasks = len(tasks)

    def get_task_bddl_file_path(self, i: int) -> str:
        """Path of a task's BDDL file."""
        task = self.tasks[i]
        root = _core.get_libero_path("bddl_files")
        return os.path.join(root, task.problem_folder, task.bddl_file)

    def get_task_init_states(self, i: int) -> Any:
        """A task's initial states: a float64 array [states, 1 + nq + nv]."""
        task = self.tasks[i]
        root = _core.get_libero_path("init_states")
        return load_init_states(os.path.join(root, task.problem_folder, task.init_states_file))


BENCHMARK_MAPPING: dict[str, type[Benchmark]] = {}


def register_benchmark(target_class: type[Benchmark]) -> type[Benchmark]:
    """Registers a suite by the name of its class, in lower case."""
    BENCHMARK_MAPPING[target_class.__name__.lower()] = target_class
    return target_class


def get_benchmark_dict(help: bool = False) -> dict[str, type[Benchmark]]:
    """All suites by name; with `help`, prints the names."""
    if help:
        print_benchmark()
    return BENCHMARK_MAPPING


def get_benchmark(benchmark_name: str) -> type[Benchmark]:
    """A suite by its name, in any case. Raises KeyError."""
    try:
        return BENCHMARK_MAPPING[benchmark_name.lower()]
    except KeyError:
        raise KeyError(
            f"there is no suite `{benchmark_name}`: choose one of {', '.join(BENCHMARK_MAPPING)}"
        ) from None


def print_benchmark() -> None:
    """Prints the suites' names."""
    print("\n".join(BENCHMARK_MAPPING))


def _suite(suite: str) -> None:
    class Suite(Benchmark):
        def __init__(self, task_order_index: int = 0) -> None:
            super().__init__(task_order_index)
            self.name = suite
            if suite == "libero_90" and task_order_index != 0:
                raise ValueError(
                    "libero_90 has one order of its tasks: leave task_order_index at 0"
                )
            self._make_benchmark()

    Suite.__name__ = Suite.__qualname__ = suite.upper()
    Suite.__doc__ = f"The suite {suite}."
    register_benchmark(Suite)


for _name in task_maps:
    _suite(_name)
