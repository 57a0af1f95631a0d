"""LIBERO's suites, and LIBERO-PRO's variants of them, such as `libero_goal_swap`."""

from __future__ import annotations

import liberopro.liberopro as _core
from libero.libero import benchmark as _libero
from libero.libero.benchmark import Task, grab_language_from_filename, libero_task_map, task_orders
from libero.libero.benchmark.registry import Registry, suite_class
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
    """A suite. Instructions are derived from the tasks' names, as in LIBERO-PRO's own code. The
    changed sentence of a `_lan` or `_task` suite is in its BDDL files only."""

    _task_maps = task_maps

    @staticmethod
    def _path(key: str) -> str:
        return _core.get_libero_path(key)


_registry = Registry[Benchmark]()
BENCHMARK_MAPPING = _registry.suites
register_benchmark = _registry.register
get_benchmark_dict = _registry.listed
get_benchmark = _registry.find
print_benchmark = _registry.print

for _name in task_maps:
    register_benchmark(suite_class(Benchmark, _name))
