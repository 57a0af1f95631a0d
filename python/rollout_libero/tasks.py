"""The forty evaluation tasks."""

from __future__ import annotations

from typing import NamedTuple

from rollout_libero._library import native

SUITES = ("libero_spatial", "libero_object", "libero_goal", "libero_10")
TASKS_PER_SUITE = 10


class Task(NamedTuple):
    """A task of the benchmark."""

    name: str
    """Suite and index in the benchmark's order, such as ``libero_goal/3``."""
    file: str
    """Stem of the names of the task's BDDL file and initial states."""
    suite: str
    instruction: str
    max_steps: int
    """Step budget of the policy in LIBERO-CTRL."""

    @classmethod
    def of(cls, name: str) -> Task:
        """Returns the task of this name.

        Raises:
            ValueError: if there is no such task; the message lists the tasks."""
        suite, index, file, instruction, max_steps = native.task(name)
        return cls(f"{suite}/{index}", file, suite, instruction, max_steps)


def tasks(suite: str | None = None) -> list[Task]:
    """Returns the tasks of a suite, or all forty.

    Raises:
        ValueError: if there is no such suite."""
    suites = SUITES if suite is None else (suite,)
    return [Task.of(f"{suite}/{index}") for suite in suites for index in range(TASKS_PER_SUITE)]
