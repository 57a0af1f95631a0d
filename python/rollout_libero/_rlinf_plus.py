"""RLinf's environments of LIBERO-Plus in one process."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rollout_libero import scenes
from rollout_libero._library import native
from rollout_libero._rlinf_rows import Frames, Rows, assets_of_libero
from rollout_libero.plus import check_assets

if TYPE_CHECKING:
    from rollout_libero._native import LegacyState, PlusPath

_CORRUPTED = "agentview_image"


class PlusRows(Rows):
    """Environments of LIBERO-Plus' variants. RLinf would start a process for each environment, with
    its own global NumPy generator; here each environment has the state of such a generator.
    ``seed`` sets these states, also during a rollout. Placements at resets and corruptions of
    frames draw from them."""

    def __init__(
        self, parameters: Sequence[dict[str, Any]], *, threads: int, draws_all: bool
    ) -> None:
        super().__init__(parameters, threads=threads, draws_all=draws_all)
        self._generators = [_seeded(seed) for seed in self._seeds]
        # State of each generator before it drew the numbers of the last frame's corruption; None if
        # the frame is not corrupted.
        self._frame_states: list[LegacyState | None] = [None] * self.env_num
        self._changes: list[tuple[str, PlusPath] | None] = [None] * self.env_num

    def reconfigure_env_fns(self, env_fns: Sequence[dict[str, Any]], id: Any = None) -> None:
        """Assigns variants and seeds to environments, as the constructor does."""
        super().reconfigure_env_fns(env_fns, id)
        for row in self._ids(id):
            self._generators[row] = _seeded(self._seeds[row])

    def seed(self, seed: int | Sequence[int]) -> list[None]:
        """Seeds all environments, with consecutive seeds if one number is given."""
        answers = super().seed(seed)
        self._generators = [_seeded(seed) for seed in self._seeds]
        return answers

    def reset(self, id: Any = None) -> NDArray[np.object_]:
        """Resets environments; the samplers place all objects."""
        rows = self._ids(id)
        for row in rows:
            self._assign_variant(row)
        list(self._pool.map(self._place_objects, rows))
        self._draw_numbers(rows, 1)
        return self._observed(self._rows.observe(rows, render="none"), rows)

    def set_init_state(self, init_state: Any, id: Any = None) -> NDArray[np.object_]:
        """Sets initial states after a reset. As in LIBERO-Plus, the controllers keep their goals,
        and the frames are not corrupted."""
        rows = self._ids(id)
        for row, state in zip(rows, init_state, strict=True):
            simulation = self._simulation(row)
            simulation.set_state(np.asarray(state, dtype=np.float64))
            simulation.forward()
            simulation.post_process()
            simulation.observe_now()
            self._frame_states[row] = None
        return self._observed(self._rows.observe(rows, render="none"), rows)

    def _assign_variant(self, row: int) -> None:
        """Gives a row a simulation of the variant that the path of the row's BDDL file names."""
        file = self._files[row]
        current = self._changes[row]
        if current is not None and current[0] == file:
            return
        check_assets(file, assets_of_libero())
        change = native.PlusPath(file)
        width, height = self._size
        change.check(height, width)
        scene = scenes.scene(os.path.realpath(change.file), assets_of_libero(), None)
        previous = self._rows.simulations[row]
        if previous is not None:
            previous.close()
        self._rows.simulations[row] = native.Simulation(scene, change=change)
        self._changes[row] = (file, change)

    def _place_objects(self, row: int) -> None:
        self._generators[row], self._loads[row] = self._simulation(row).reset(
            self._generators[row], self._loads[row] + 1
        )

    def _draw_numbers(self, rows: list[int], steps: int) -> None:
        list(self._pool.map(lambda row: self._draw_numbers_of_row(row, steps), rows))

    def _draw_numbers_of_row(self, row: int, frames: int) -> None:
        change = self._change(row)
        if not change.noise:
            return
        width, height = self._size
        for _ in range(frames):
            self._frame_states[row] = self._generators[row]
            self._generators[row] = change.skip(self._generators[row], height, width)

    def _frame_change(self, row: int) -> Callable[[Frames], Frames]:
        change, state = self._change(row), self._frame_states[row]
        if not change.noise or state is None:
            return super()._frame_change(row)
        return lambda frames: {
            key: change.corrupted(state, frame) if key == _CORRUPTED else frame
            for key, frame in frames.items()
        }

    def _change(self, row: int) -> PlusPath:
        current = self._changes[row]
        if current is None:
            raise ValueError(f"failed to use row {row}: it has no rollout; call reset")
        return current[1]


def _seeded(seed: int) -> LegacyState:
    """Returns the state of NumPy's generator after ``numpy.random.seed(seed)``."""
    state: LegacyState = np.random.RandomState(seed).get_state()  # type: ignore[assignment]
    return state
