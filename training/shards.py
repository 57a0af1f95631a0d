"""Collected episodes on disk: folders of shards, each with some dozens of episodes.

A shard has F frames and E episodes. Its arrays are

    frames.npy       uint8   [F, 2, 128, 128, 3]  both cameras, row 0 at the top
    table.npz:
      state          float32 [F, 14]  the robot's state at the frame
      target         float32 [F, 8, 7]  the expert's next actions; NaN after the goal is reached
      frames         int32   [E]      number of frames in the episode
      task           int16   [E]      index in ``wordings.TASK_NAMES``
      outcome        uint8   [E]      an ``Outcome``
      driver         uint8   [E]      a ``Driver``
      perturbation   str     [E]      configuration, or "" for an unperturbed episode"""

import os
import queue
import shutil
import threading
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

FRAMES_PER_SHARD = 2_000
PREFIX = "shard_"
STALL_FRAMES = 12
STALL_M = 0.008
"""The robot has stalled if hand and fingers have moved less than this distance, metres, in the last
``STALL_FRAMES`` frames."""


class Outcome(IntEnum):
    FAILURE = 0
    SUCCESS = 1
    UNFINISHED = 2
    """The collection ended before the episode did."""


class Driver(IntEnum):
    CLEAN = 0
    """The expert, undisturbed."""
    DISTURBED = 1
    """The expert, with noise and pushes."""
    IN_TURNS = 2
    """Student and expert in turns."""
    STUDENT = 3
    """The student alone."""


class Episode(NamedTuple):
    """One rollout; the module's documentation describes the arrays."""

    task: int
    outcome: Outcome
    driver: Driver
    perturbation: str
    frames: NDArray[np.uint8]
    state: NDArray[np.float32]
    target: NDArray[np.float32]


class Shard(NamedTuple):
    """The contents of a shard; the module's documentation describes the arrays."""

    frames: NDArray[np.uint8]
    state: NDArray[np.float32]
    target: NDArray[np.float32]
    episode_frames: NDArray[np.int32]
    task: NDArray[np.int16]
    outcome: NDArray[np.uint8]
    driver: NDArray[np.uint8]
    perturbation: NDArray[np.str_]

    def repeat_per_frame(self, values: NDArray[Any]) -> NDArray[Any]:
        """Repeats each episode's value, [E], for each of the episode's frames, [F]."""
        return np.repeat(values, self.episode_frames)


def worth_learning(shard: Shard) -> NDArray[np.bool_]:
    """Returns a mask [E] of the episodes for training: all except the episodes in which the expert
    drove alone and failed."""
    by_expert = (shard.driver == Driver.CLEAN) | (shard.driver == Driver.DISTURBED)
    return np.asarray(~(by_expert & (shard.outcome == Outcome.FAILURE)), bool)


def stalled(shard: Shard) -> NDArray[np.bool_]:
    """Returns a mask [F] of the frames in which the robot has stalled (see ``STALL_M``).

    In these frames the expert makes no progress, or the student does not follow the expert. A few
    such frames are instructive; hundreds would dominate the training."""
    first = shard.repeat_per_frame(np.cumsum(shard.episode_frames) - shard.episode_frames)
    number = np.arange(len(shard.state)) - first
    values = np.concatenate([shard.state[:, :3], shard.state[:, -2:]], axis=1)
    moved = np.zeros(len(values), np.float32)
    # Each frame is compared with each of the ``STALL_FRAMES`` frames before it in its episode.
    for distance in range(1, STALL_FRAMES + 1):
        earlier = np.maximum(np.arange(len(values)) - distance, first)
        moved = np.maximum(moved, np.abs(values - values[earlier]).max(axis=1))
    return np.asarray((number >= STALL_FRAMES) & (moved < STALL_M), bool)


def shard_folders(folder: Path) -> list[Path]:
    """Returns the folders of the shards in a folder, in the order of their numbers."""
    return sorted(path for path in folder.glob(f"{PREFIX}*") if not path.name.endswith(".part"))


def next_number(folder: Path) -> int:
    """Returns the number of the next shard to be written to a folder."""
    numbers = (int(path.name.removeprefix(PREFIX)) for path in shard_folders(folder))
    return max(numbers, default=-1) + 1


def write(folder: Path, number: int, episodes: list[Episode]) -> Path:
    """Writes a shard atomically, and returns its folder."""
    table: dict[str, Any] = {
        "state": np.concatenate([episode.state for episode in episodes]),
        "target": np.concatenate([episode.target for episode in episodes]),
        "frames": np.array([len(episode.frames) for episode in episodes], np.int32),
        "task": np.array([episode.task for episode in episodes], np.int16),
        "outcome": np.array([episode.outcome for episode in episodes], np.uint8),
        "driver": np.array([episode.driver for episode in episodes], np.uint8),
        "perturbation": np.array([episode.perturbation for episode in episodes], np.str_),
    }
    complete = folder / f"{PREFIX}{number:05}"
    part = complete.with_name(complete.name + ".part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    np.savez(part / "table.npz", **table)
    np.save(part / "frames.npy", np.concatenate([episode.frames for episode in episodes]))
    os.replace(part, complete)
    return complete


def read(folder: Path) -> Shard:
    with np.load(folder / "table.npz") as table:
        return Shard(
            np.load(folder / "frames.npy"),
            table["state"], table["target"], table["frames"], table["task"], table["outcome"],
            table["driver"], table["perturbation"],
        )  # fmt: skip


class Writer:
    """Gathers episodes into shards and writes them on a separate thread."""

    def __init__(self, folder: Path, frames_per_shard: int = FRAMES_PER_SHARD) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._frames_per_shard = frames_per_shard
        self._number = next_number(folder)
        self._gathered: list[Episode] = []
        self._frames = 0
        self._lock = threading.Lock()
        # The queue is short, so that a slow disk slows the collection instead of filling the
        # memory.
        self._full: queue.Queue[list[Episode] | None] = queue.Queue(maxsize=4)
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._write_all)
        self._thread.start()

    def add(self, episode: Episode) -> None:
        """Adds an episode. Any thread may call this."""
        full = None
        with self._lock:
            self._gathered.append(episode)
            self._frames += len(episode.frames)
            if self._frames >= self._frames_per_shard:
                full, self._gathered, self._frames = self._gathered, [], 0
        if full:
            self._queue(full)

    def close(self) -> None:
        """Writes the remaining episodes and ends the thread. Raises OSError if a shard could not be
        written."""
        if self._gathered:
            self._queue(self._gathered)
            self._gathered = []
        self._full.put(None)
        self._thread.join()
        if self._error:
            raise self._error

    def _queue(self, episodes: list[Episode]) -> None:
        """Queues a shard's episodes for the writing thread."""
        if self._error:
            raise self._error
        self._full.put(episodes)

    def _write_all(self) -> None:
        while (episodes := self._full.get()) is not None:
            if self._error is None:
                try:
                    write(self._folder, self._number, episodes)
                except OSError as error:
                    self._error = error
                self._number += 1
