"""Collected episodes on disk: folders of shards, each of some dozens of episodes.

A shard has F frames, S control steps and E episodes. There is a frame before
every few steps, and a label for every step.

    frames.npy       uint8   [F, 2, 128, 128, 3]  both cameras, row 0 at the top
    table.npz:
      state          float32 [F, 14]  of the robot, at the frame
      frame_step     int32   [F]      the step that follows the frame, counted in the shard
      label          float32 [S, 7]   the expert's action
      executed       float32 [S, 7]   the executed action
      source         uint8   [S]      the driver of the step
      frames, steps  int32   [E]      number of each in an episode
      task           int16   [E]      index in ``wordings.TASK_NAMES``
      outcome        uint8   [E]
      driver         uint8   [E]
      perturbation   str     [E]      "" if there was none
"""

from __future__ import annotations

import os
import queue
import shutil
import threading
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from training.network import CHUNK

FRAMES_PER_SHARD = 2_000
PREFIX = "shard_"
MAX_DRIFT = 0.5
"""Bound on the sum of the differences between the student's and the expert's actions within a
chunk, along any axis (0.025 m). Beyond it, the expert's later labels no longer count."""


STALL_FRAMES = 12
STALL_M = 0.008
"""The robot has stalled if hand and fingers stay within this range for ``STALL_FRAMES`` frames."""


class Source(IntEnum):
    """Driver of a step."""

    EXPERT = 0
    NOISE = 1
    """The expert's action with Gaussian noise."""
    PUSH = 2
    """The expert's action plus a push."""
    STUDENT = 3


class Outcome(IntEnum):
    """End of an episode."""

    FAILURE = 0
    SUCCESS = 1
    UNFINISHED = 2
    """The collection ended before the episode."""


class Driver(IntEnum):
    """Driver of an episode."""

    CLEAN = 0
    """The expert, undisturbed."""
    DISTURBED = 1
    """The expert, with noise and pushes."""
    IN_TURNS = 2
    """Student and expert in turns."""
    STUDENT = 3
    """The student alone."""


class Episode(NamedTuple):
    """One rollout; ``frame_step`` is counted from its first step."""

    task: int
    outcome: Outcome
    driver: Driver
    perturbation: str
    frames: NDArray[np.uint8]
    state: NDArray[np.float32]
    frame_step: NDArray[np.int32]
    label: NDArray[np.float32]
    executed: NDArray[np.float32]
    source: NDArray[np.uint8]


class Shard(NamedTuple):
    """A shard's contents."""

    frames: NDArray[np.uint8]
    state: NDArray[np.float32]
    frame_step: NDArray[np.int32]
    label: NDArray[np.float32]
    executed: NDArray[np.float32]
    source: NDArray[np.uint8]
    episode_frames: NDArray[np.int32]
    episode_steps: NDArray[np.int32]
    task: NDArray[np.int16]
    outcome: NDArray[np.uint8]
    driver: NDArray[np.uint8]
    perturbation: NDArray[np.str_]

    def repeat_per_frame(self, values: NDArray[Any]) -> NDArray[Any]:
        """Repeats each episode's value, [E], for each of the episode's frames, [F]."""
        return np.repeat(values, self.episode_frames)


class Targets(NamedTuple):
    """The network's target output at each of F frames."""

    actions: NDArray[np.float32]
    """[F, 8, 7]: the expert's actions."""
    valid: NDArray[np.bool_]
    """[F, 8]: True if the action counts."""


def targets(shard: Shard) -> Targets:
    """Returns the expert's next eight actions at each frame, and a mask of those that count.

    An action counts until the episode's end or a deviation from the expert: a step in
    which the robot was pushed, or in which the student moved the gripper differently or
    drifted too far. Noise does not matter: its mean is zero.
    """
    first = shard.frame_step[:, np.newaxis]
    steps = first + np.arange(CHUNK)
    end = shard.repeat_per_frame(np.cumsum(shard.episode_steps))[:, np.newaxis]
    pushed = _sum_before(shard.source == Source.PUSH)
    by_student = shard.source == Source.STUDENT
    deviation = (shard.executed - shard.label).astype(np.float64) * by_student[:, np.newaxis]
    gripper_differs = _sum_before(np.abs(deviation[:, 6]) > 0.5)
    drift = _sum_before(deviation[:, :3])
    last_step = np.minimum(steps, len(shard.label) - 1)
    valid = (
        (steps < end)
        & (pushed[last_step] == pushed[first])
        & (gripper_differs[last_step] == gripper_differs[first])
        & (np.abs(drift[last_step] - drift[first]).max(axis=2) <= MAX_DRIFT)
    )
    return Targets(shard.label[np.minimum(steps, end - 1)], valid)


def _sum_before(values: NDArray[Any]) -> NDArray[Any]:
    """Returns the sum of the values of all earlier steps, for each step."""
    total = np.cumsum(values, axis=0)
    return np.concatenate([np.zeros_like(total[:1]), total[:-1]])


def worth_learning(shard: Shard) -> NDArray[np.bool_]:
    """Returns a mask [E] of the episodes for training: all except those in which the expert
    failed without the student."""
    by_expert = (shard.driver == Driver.CLEAN) | (shard.driver == Driver.DISTURBED)
    return np.asarray(~(by_expert & (shard.outcome == Outcome.FAILURE)), bool)


def stalled(shard: Shard) -> NDArray[np.bool_]:
    """Returns a mask [F] of the frames in which the robot has stalled (see ``STALL_M``).

    In these frames the expert makes no progress, or the student does not follow it. A
    few such frames are instructive; hundreds would dominate the training.
    """
    first = shard.repeat_per_frame(np.cumsum(shard.episode_frames) - shard.episode_frames)
    number = np.arange(len(shard.state)) - first
    values = np.concatenate([shard.state[:, :3], shard.state[:, -2:]], axis=1)
    moved = np.zeros(len(values), np.float32)
    # Compares with each of the last frames, within the episode.
    for back in range(1, STALL_FRAMES + 1):
        earlier = np.maximum(np.arange(len(values)) - back, first)
        moved = np.maximum(moved, np.abs(values - values[earlier]).max(axis=1))
    return np.asarray((number >= STALL_FRAMES) & (moved < STALL_M), bool)


def shard_folders(folder: Path) -> list[Path]:
    """Returns the shards of a folder, in order."""
    return sorted(path for path in folder.glob(f"{PREFIX}*") if not path.name.endswith(".part"))


def next_number(folder: Path) -> int:
    """Returns the number of the next shard."""
    numbers = (int(path.name.removeprefix(PREFIX)) for path in shard_folders(folder))
    return max(numbers, default=-1) + 1


def write(folder: Path, number: int, episodes: list[Episode]) -> Path:
    """Writes a shard atomically."""
    steps = np.array([len(episode.label) for episode in episodes], np.int32)
    first_steps = np.cumsum(steps, dtype=np.int32) - steps
    table: dict[str, Any] = {
        "state": np.concatenate([episode.state for episode in episodes]),
        "frame_step": np.concatenate(
            [episode.frame_step + at for episode, at in zip(episodes, first_steps, strict=True)]
        ).astype(np.int32),
        "label": np.concatenate([episode.label for episode in episodes]),
        "executed": np.concatenate([episode.executed for episode in episodes]),
        "source": np.concatenate([episode.source for episode in episodes]),
        "frames": np.array([len(episode.frames) for episode in episodes], np.int32),
        "steps": steps,
        "task": np.array([episode.task for episode in episodes], np.int16),
        "outcome": np.array([episode.outcome for episode in episodes], np.uint8),
        "driver": np.array([episode.driver for episode in episodes], np.uint8),
        "perturbation": np.array([episode.perturbation for episode in episodes], np.str_),
    }
    done = folder / f"{PREFIX}{number:05}"
    part = done.with_name(done.name + ".part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    np.savez(part / "table.npz", **table)
    np.save(part / "frames.npy", np.concatenate([episode.frames for episode in episodes]))
    os.replace(part, done)
    return done


def read(folder: Path) -> Shard:
    """Reads a shard from its folder."""
    with np.load(folder / "table.npz") as table:
        return Shard(
            np.load(folder / "frames.npy"),
            table["state"], table["frame_step"], table["label"], table["executed"], table["source"],
            table["frames"], table["steps"], table["task"], table["outcome"], table["driver"],
            table["perturbation"],
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
        # A short queue, so that a slow disk slows the collection rather than filling the memory.
        self._full: queue.Queue[list[Episode] | None] = queue.Queue(maxsize=4)
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._write_all)
        self._thread.start()

    def add(self, episode: Episode) -> None:
        """Adds an episode, from any thread."""
        full = None
        with self._lock:
            self._gathered.append(episode)
            self._frames += len(episode.frames)
            if self._frames >= self._frames_per_shard:
                full, self._gathered, self._frames = self._gathered, [], 0
        if full:
            self._queue(full)

    def close(self) -> None:
        """Writes the remaining episodes."""
        if self._gathered:
            self._queue(self._gathered)
            self._gathered = []
        self._full.put(None)
        self._thread.join()
        if self._error:
            raise self._error

    def _queue(self, episodes: list[Episode]) -> None:
        """Queues a shard's episodes for the thread that writes."""
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
