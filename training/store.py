"""Frames and targets in the memory of the training device."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from training.network import ARM, CHUNK, PICTURE, STATE
from training.shards import Shard, read, shard_folders, stalled, worth_learning
from training.wordings import TASK_NAMES

FRAME_BYTES = 2 * PICTURE * PICTURE * 3
WORD = 8
"""Bytes per word; frames are stored and copied in words."""
READERS = 8
"""Number of threads that read shards."""
HELD_OUT_INTERVAL = 50
"""Of this many episodes of a shard, one is held out for validation."""


class Batch(NamedTuple):
    pictures: Tensor
    """uint8 [n, 2, 128, 128, 3]"""
    state: Tensor
    """[n, 14]"""
    task: Tensor
    """int64 [n]"""
    targets: Tensor
    """[n, 8, 7]: the expert's actions."""
    valid: Tensor
    """[n, 8]: 1 for targets that count in the loss, 0 for the others."""


class Store:
    """Samples in the device's memory, up to a capacity."""

    def __init__(self, capacity: int, device: torch.device) -> None:
        self.count = 0
        self.capacity = capacity
        # Rows consist of 64-bit words: with bytes, a gather would be eight times as slow.
        self._frames = torch.empty(capacity, FRAME_BYTES // WORD, dtype=torch.int64, device=device)
        self._state = torch.empty(capacity, STATE, device=device)
        self._task = torch.empty(capacity, dtype=torch.int64, device=device)
        self._targets = torch.empty(capacity, CHUNK, ARM + 1, device=device)
        self._valid = torch.empty(capacity, CHUNK, device=device)

    def add(self, shard: Shard, indices: NDArray[np.int64]) -> int:
        """Copies the frames at ``indices`` of a shard, and returns the number of copied frames.
        When the store is full, new frames replace stored frames drawn at random."""
        indices = indices[: self.capacity]
        if not len(indices):
            return 0
        device = self._frames.device
        appended = min(len(indices), self.capacity - self.count)
        rows = torch.arange(self.count, self.count + appended, device=device)
        if appended < len(indices):
            replaced = torch.randperm(self.capacity - appended, device=device)
            rows = torch.cat([rows, replaced[: len(indices) - appended]])
        target = torch.from_numpy(shard.target[indices]).to(device)
        task = torch.from_numpy(shard.repeat_per_frame(shard.task)[indices].astype(np.int64))
        frames = torch.from_numpy(shard.frames).view(-1, FRAME_BYTES).view(torch.int64).to(device)
        self._frames[rows] = frames[torch.from_numpy(indices).to(device)]
        self._state[rows] = torch.from_numpy(shard.state[indices]).to(self._state.device)
        self._task[rows] = task.to(self._task.device)
        self._targets[rows] = target.nan_to_num()
        self._valid[rows] = target[:, :, 0].isfinite().float()
        self.count += appended
        return len(indices)

    def draw(self, n: int) -> Batch:
        """Draws n samples with replacement."""
        return self.batch(torch.randint(self.count, (n,), device=self._frames.device))

    def batch(self, indices: Tensor) -> Batch:
        """Returns the samples at these indices, [n]."""
        frames = self._frames.index_select(0, indices).view(torch.uint8)
        return Batch(
            frames.view(len(indices), 2, PICTURE, PICTURE, 3),
            self._state[indices],
            self._task[indices],
            self._targets[indices],
            self._valid[indices],
        )

    def state_scale(self) -> tuple[Tensor, Tensor]:
        """Returns mean and standard deviation of the robot's state, [14] each."""
        state = self._state[: self.count]
        # Without the lower limit, a nearly constant number would be scaled up to large values.
        return state.mean(0), state.std(0).clamp(min=0.01)


class Library:
    """The shards of some folders, loaded into a store for training and one for validation."""

    def __init__(
        self, folders: list[Path], capacity: int, held_out_capacity: int, device: torch.device
    ) -> None:
        self._folders = folders
        self._loaded: set[Path] = set()
        self.training = Store(capacity, device)
        self.held_out = Store(held_out_capacity, device)
        self.by_suite = np.zeros(4, np.int64)
        """Frames added to the training store, by suite in the order of ``TASK_NAMES``."""

    def refresh(self) -> int:
        """Loads the new shards. Returns the number of frames by which the stores grew."""
        before = self.training.count + self.held_out.count
        paths = [path for folder in self._folders for path in shard_folders(folder)]
        new = [path for path in paths if path not in self._loaded]
        self._loaded.update(new)
        with ThreadPoolExecutor(READERS) as readers:
            # Shards are read in groups, to limit the host memory of those not on the device yet.
            for first in range(0, len(new), READERS):
                group = new[first : first + READERS]
                for path, shard in zip(group, readers.map(read, group), strict=True):
                    self._add(shard, path)
        return self.training.count + self.held_out.count - before

    def _add(self, shard: Shard, path: Path) -> None:
        held_out = _held_out(path, len(shard.task))
        usable = worth_learning(shard)
        is_moving = ~stalled(shard)
        training = np.flatnonzero(shard.repeat_per_frame(usable & ~held_out) & is_moving)
        added = self.training.add(shard, training)
        if self.held_out.count < self.held_out.capacity:
            validation = np.flatnonzero(shard.repeat_per_frame(usable & held_out) & is_moving)
            self.held_out.add(shard, validation)
        suite = shard.repeat_per_frame(shard.task)[training[:added]] // 10
        self.by_suite += np.bincount(suite, minlength=len(TASK_NAMES) // 10)


def _held_out(path: Path, episodes: int) -> NDArray[np.bool_]:
    """Returns a mask of a shard's episodes for validation. It depends only on the shard's number,
    and consecutive shards hold out different positions."""
    number = int(path.name.split("_")[1])
    return np.equal(np.arange(episodes) % HELD_OUT_INTERVAL, (7 * number) % HELD_OUT_INTERVAL)
