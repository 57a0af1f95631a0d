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
    """Environments of LIBERO-Plus' variants. Each has NumPy's generator of the process that RLinf
    would start for it: ``seed`` seeds it, also during a rollout, resets place objects with its
    numbers, and the corruption of every frame continues with them."""

    def __init__(
        self, parameters: Sequence[dict[str, Any]], *, threads: int, draws_all: bool
    ) -> None:
        super().__init__(parameters, threads=threads, draws_all=draws_all)
        self._generators = [_seeded(seed) for seed in self._seeds]
        # State of each generator before the numbers of the last frame; None if it is not corrupted.
        self._before: list[LegacyState | None] = [None] * self.env_num
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
            self._make(row)
        list(self._pool.map(self._place, rows))
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
            self._before[row] = None
        return self._observed(self._rows.observe(rows, render="none"), rows)

    def _make(self, row: int) -> None:
        """Assigns the variant of its file to a row's simulation."""
        file = self._files[row]
        made = self._changes[row]
        if made is not None and made[0] == file:
            return
        check_assets(file, assets_of_libero())
        change = native.PlusPath(file)
        width, height = self._size
        change.check(height, width)
        scene = scenes.scene(os.path.realpath(change.file), assets_of_libero())
        held = self._rows.simulations[row]
        if held is not None:
            held.close()
        self._rows.simulations[row] = native.Simulation(scene, change=change)
        self._changes[row] = (file, change)

    def _place(self, row: int) -> None:
        self._generators[row], self._loads[row] = self._simulation(row).reset(
            self._generators[row], self._loads[row] + 1
        )

    def _draw_numbers(self, rows: list[int], steps: int) -> None:
        list(self._pool.map(lambda row: self._skip(row, steps), rows))

    def _skip(self, row: int, frames: int) -> None:
        change = self._change(row)
        if not change.noise:
            return
        width, height = self._size
        for _ in range(frames):
            self._before[row] = self._generators[row]
            self._generators[row] = change.skip(self._generators[row], height, width)

    def _shown(self, row: int) -> Callable[[Frames], Frames]:
        change, before = self._change(row), self._before[row]
        if not change.noise or before is None:
            return super()._shown(row)
        return lambda frames: {
            key: change.corrupted(before, frame) if key == _CORRUPTED else frame
            for key, frame in frames.items()
        }

    def _change(self, row: int) -> PlusPath:
        made = self._changes[row]
        if made is None:
            raise ValueError(f"failed to step row {row}: it has no rollout; call reset")
        return made[1]

    def _simulation(self, row: int) -> Any:
        return self._rows.simulations[row]


def _seeded(seed: int) -> LegacyState:
    """Returns the state of NumPy's generator after ``numpy.random.seed(seed)``."""
    state: LegacyState = np.random.RandomState(seed).get_state()  # type: ignore[assignment]
    return state
