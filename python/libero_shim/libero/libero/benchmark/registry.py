"""Suites by name, as LIBERO's and LIBERO-PRO's packages register them."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

_Suite = TypeVar("_Suite")
_Class = TypeVar("_Class", bound=type[Any])


class Registry(Generic[_Suite]):
    """Classes of suites by their names in lower case."""

    def __init__(self) -> None:
        self.suites: dict[str, type[_Suite]] = {}

    def register(self, target_class: _Class) -> _Class:
        """Registers a suite under its class's name, in lower case."""
        self.suites[target_class.__name__.lower()] = target_class
        return target_class

    def listed(self, help: bool = False) -> dict[str, type[_Suite]]:
        """Returns all suites by name; with `help`, prints the names."""
        if help:
            self.print()
        return self.suites

    def find(self, benchmark_name: str) -> type[_Suite]:
        """Returns the suite of a name, in upper or lower case. Raises KeyError if there is none."""
        try:
            return self.suites[benchmark_name.lower()]
        except KeyError:
            raise KeyError(
                f"there is no suite `{benchmark_name}`: choose one of {', '.join(self.suites)}"
            ) from None

    def print(self) -> None:
        print("\n".join(self.suites))


def suite_class(base: type[Any], suite: str) -> type[Any]:
    class Suite(base):  # type: ignore[misc]
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
    return Suite
