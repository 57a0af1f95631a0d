"""Compiled scenes, shared, and the simulation that an environment holds until it is closed."""

from __future__ import annotations

import os
import threading
import weakref

import numpy as np
from rollout_libero import files
from rollout_libero._native import Scene, Simulation

from libero.libero.paths import get_assets_path


class ClosedError(RuntimeError):
    """An environment is used after it was closed."""


class CompiledScene:
    """A scene that lives as long as an environment uses it."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene


_compiled: weakref.WeakValueDictionary[tuple[str, int, str, str], CompiledScene] = (
    weakref.WeakValueDictionary()
)
_compiling = threading.Lock()
#: Resets take turns at NumPy's global generator.
_drawing = threading.Lock()


def compiled_scene(bddl_file: str) -> CompiledScene:
    """The scene of a task's file, compiled once for all environments that use it.

    Raises FileNotFoundError where assets are missing; the message has the remedy.
    """
    assets, sources = get_assets_path(), str(files.sources())
    path = os.path.realpath(bddl_file)
    key = (path, os.stat(path).st_mtime_ns, assets, sources)
    with _compiling:
        compiled = _compiled.get(key)
        if compiled is None:
            compiled = CompiledScene(Scene(path, assets=assets, sources=sources))
            _compiled[key] = compiled
        return compiled


class Held:
    """A simulation until it is closed."""

    def __init__(self, compiled: CompiledScene) -> None:
        self._compiled: CompiledScene | None = compiled
        self._simulation: Simulation | None = Simulation(compiled.scene)

    @property
    def scene(self) -> Scene:
        """The compiled scene."""
        return self.get().scene

    def get(self) -> Simulation:
        """The simulation.

        Raises ClosedError.
        """
        if self._simulation is None:
            raise ClosedError("the environment is closed: construct a new one to go on")
        return self._simulation

    def close(self) -> None:
        """Lets go of the simulation."""
        self._simulation = self._compiled = None

    def start_over(self, model_loads: int) -> None:
        """Places everything anew, drawing from NumPy's global generator as the original
        does. `model_loads`: how often the original had loaded the model by now."""
        simulation = self.get()
        with _drawing:
            state = np.random.get_state()
            if state[0] != "MT19937":
                raise RuntimeError(
                    f"NumPy's global generator is {state[0]}: LIBERO draws from MT19937; set it "
                    "back with numpy.random.set_bit_generator(numpy.random.MT19937())"
                )
            np.random.set_state(simulation.reset(state, model_loads))
