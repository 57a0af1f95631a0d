"""The simulation that an environment holds until it is closed."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from libero.libero.paths import get_assets_path
from rollout_libero import ClosedError
from rollout_libero._native import PlusPath, Scene, Simulation
from rollout_libero.scenes import scene

if TYPE_CHECKING:
    from rollout_libero._native import LegacyState

__all__ = ["ClosedError", "SimulationHandle", "draw_numbers"]

#: Lock on NumPy's global generator while its numbers are drawn.
_drawing = threading.Lock()

_Result = TypeVar("_Result")


def draw_numbers(numbers: Callable[[LegacyState], tuple[LegacyState, _Result]]) -> _Result:
    """Draws from NumPy's global generator: calls `numbers` with the generator's state, and sets the
    state that `numbers` returns. Returns the result of `numbers`. Raises RuntimeError if the global
    generator is not of LIBERO's kind, MT19937."""
    with _drawing:
        state = np.random.get_state()
        if isinstance(state, dict):  # the state of a generator other than MT19937
            raise RuntimeError(  # noqa: TRY004
                f"NumPy's global generator is {state['bit_generator']}: LIBERO draws from "
                "MT19937; set it back with "
                "numpy.random.set_bit_generator(numpy.random.MT19937())"
            )
        state, result = numbers(state)
        np.random.set_state(state)
    return result


class SimulationHandle:
    """Handle of a simulation of a BDDL file's scene. `close` frees the simulation. All environments
    of a scene share the compiled scene. Raises FileNotFoundError if assets are missing; the message
    has the remedy."""

    def __init__(
        self, bddl_file: str, change: PlusPath | None = None, look: str | None = None
    ) -> None:
        self._simulation: Simulation | None = Simulation(
            scene(os.path.realpath(bddl_file), get_assets_path(), look), change=change
        )

    @property
    def scene(self) -> Scene:
        return self.get().scene

    def get(self) -> Simulation:
        """The simulation. Raises ClosedError."""
        if self._simulation is None:
            raise ClosedError("the environment is closed: construct a new one to go on")
        return self._simulation

    def close(self) -> None:
        """Frees the simulation. Closing again does nothing."""
        if self._simulation is not None:
            self._simulation.close()
            self._simulation = None

    def start_over(self, model_loads: int, *, hard: bool) -> int:
        """Resets all placements, drawing from NumPy's global generator as LIBERO does.

        `model_loads` is the number of times that LIBERO would have loaded its model so far. Returns
        that number after the reset; it grows when placements are drawn again for lack of room."""
        simulation = self.get()
        return draw_numbers(lambda state: simulation.reset(state, model_loads, hard=hard))
