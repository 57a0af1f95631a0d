"""Augmentation: changes of pictures and instructions that must not change the student's actions.

Random numbers are drawn, and pictures are changed, on the batch's device, usually the GPU."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from training.network import PICTURE
from training.text import features
from training.wordings import TASK_NAMES, draw

MAX_SHIFT = 4
"""Largest shift in each direction, pixels; a picture has 128 × 128."""
GAIN = 0.12
TINT = 0.06
BRIGHTNESS = 0.08
"""Standard deviations: ``GAIN`` of the log contrast, ``TINT`` of the log gain of each colour,
``BRIGHTNESS`` of the offset that is added to pixels, which are in -1..1."""
MAX_NOISE = 0.04
"""Greatest standard deviation of the noise on pixels, which are in -1..1."""

CANONICAL_SHARE = 0.2
"""Probability that a sample has the benchmark's own instruction."""
MAX_WORDS_DROPPED = 0.25
MAX_PAIRS_DROPPED = 0.6
"""Largest probabilities with which a word of an instruction is dropped, and a pair of kept
neighbouring words. Dropped words simulate words that never occur in training."""


class PictureChange(NamedTuple):
    """Changes to the two pictures of n frames."""

    shift: Tensor
    """[n, 2, 2] int64: shift by rows and columns, pixels."""
    gain: Tensor
    """[n, 2, 1, 1, 3]: factor on each colour."""
    brightness: Tensor
    """[n, 2, 1, 1, 1]: brightness offset."""
    noise: Tensor
    """[n, 2, 1, 1, 1]: standard deviation of the noise on pixels."""


def draw_changes(n: int, device: torch.device) -> PictureChange:
    """Draws changes for n frames."""
    shift = torch.randint(-MAX_SHIFT, MAX_SHIFT + 1, (n, 2, 2), device=device)
    contrast = GAIN * torch.randn(n, 2, 1, 1, 1, device=device)
    tint = TINT * torch.randn(n, 2, 1, 1, 3, device=device)
    brightness = BRIGHTNESS * torch.randn(n, 2, 1, 1, 1, device=device)
    noise = MAX_NOISE * torch.rand(n, 2, 1, 1, 1, device=device).square()
    return PictureChange(shift, (contrast + tint).exp(), brightness, noise)


def apply_changes(pictures: Tensor, change: PictureChange) -> tuple[Tensor, Tensor]:
    """Returns both cameras' pictures with these changes, in the network's input format.

    Args:
        pictures: uint8 [n, 2, 128, 128, 3].

    Returns:
        Two tensors [n, 3, 128, 128], channels last in memory. Where a shift
        uncovers an edge, the picture's own edge is repeated."""
    n, device = len(pictures), pictures.device
    positions = torch.arange(PICTURE, device=device)
    sources = (positions + change.shift[:, :, :, None]).clamp(0, PICTURE - 1)
    frame = torch.arange(n, device=device)[:, None, None, None]
    camera = torch.arange(2, device=device)[None, :, None, None]
    shifted = pictures[frame, camera, sources[:, :, 0, :, None], sources[:, :, 1, None, :]]
    x = (shifted.float() / 127.5 - 1.0) * change.gain + change.brightness
    x = (x + torch.randn_like(x) * change.noise).clamp(-1.0, 1.0).permute(0, 1, 4, 2, 3)
    return x[:, 0], x[:, 1]


class Wordings:
    """Many wordings of each task, as features on the batch's device. Wording 0 is the benchmark's
    own instruction."""

    def __init__(self, per_task: int, seed: int, device: torch.device, processes: int = 1) -> None:
        by_task = _all_features(per_task, seed, processes)
        longest = max(len(word_rows) for wordings in by_task for word_rows, _ in wordings)
        words = np.zeros((len(by_task), per_task, longest), np.int16)
        pairs = np.zeros((len(by_task), per_task, longest - 1), np.int16)
        lengths = np.zeros((len(by_task), per_task), np.int16)
        for task, wordings in enumerate(by_task):
            for number, (word_rows, pair_rows) in enumerate(wordings):
                words[task, number, : len(word_rows)] = word_rows
                pairs[task, number, : len(pair_rows)] = pair_rows
                lengths[task, number] = len(word_rows)
        self._words = torch.from_numpy(words).to(device)
        self._pairs = torch.from_numpy(pairs).to(device)
        self._lengths = torch.from_numpy(lengths).to(device)
        self._per_task = per_task

    def draw(self, task: Tensor) -> tuple[Tensor, Tensor]:
        """Draws a wording for each of n samples, and drops words of some wordings.

        Args:
            task: int64 [n], the index of each sample's task.

        Returns:
            The features' rows, int64 [n, w], and a mask [n, w]: 1 where there is a feature."""
        n, device = len(task), task.device
        number = torch.randint(self._per_task, (n,), device=device)
        canonical = torch.rand(n, device=device) < CANONICAL_SHARE
        number = torch.where(canonical, 0, number)
        words, pairs = self._words[task, number], self._pairs[task, number]
        present = torch.arange(words.shape[1], device=device) < self._lengths[task, number, None]
        kept = present & _draw_kept(words, MAX_WORDS_DROPPED, canonical)
        pairs_kept = kept[:, 1:] & kept[:, :-1] & _draw_kept(pairs, MAX_PAIRS_DROPPED, canonical)
        mask = torch.cat([kept, pairs_kept], dim=1).float()
        return torch.cat([words, pairs], dim=1).long(), mask

    def canonical(self, task: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the benchmark's own instructions of n samples, in the form that ``draw``
        returns."""
        words, pairs = self._words[task, 0], self._pairs[task, 0]
        present = torch.arange(words.shape[1], device=task.device) < self._lengths[task, 0, None]
        pairs_present = present[:, 1:] & present[:, :-1]
        mask = torch.cat([present, pairs_present], dim=1).float()
        return torch.cat([words, pairs], dim=1).long(), mask


def _draw_kept(rows: Tensor, max_dropped: float, canonical: Tensor) -> Tensor:
    """Draws a mask of the features to keep: all features of canonical instructions and of half of
    the other instructions; from the remaining instructions, features are dropped at random."""
    n, device = len(rows), rows.device
    dropped = max_dropped * torch.rand(n, 1, device=device)
    is_whole = canonical[:, None] | (torch.rand(n, 1, device=device) < 0.5)
    dropped = torch.where(is_whole, 0.0, dropped)
    return torch.rand(rows.shape, device=device) >= dropped


Features = Sequence[tuple[list[int], list[int]]]
"""Rows of the words, and of the pairs, of each wording of a task."""


def _all_features(per_task: int, seed: int, processes: int) -> Sequence[Features]:
    features_of_task = partial(_features_of_task, per_task, seed)
    if processes == 1:
        return [features_of_task(task) for task in TASK_NAMES]
    with ProcessPoolExecutor(processes) as pool:
        return list(pool.map(features_of_task, TASK_NAMES))


def _features_of_task(per_task: int, seed: int, task: str) -> Features:
    return [features(text) for text in draw(task, per_task, seed)]
