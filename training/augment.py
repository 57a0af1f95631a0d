"""Augmentation of pictures and instructions that must not change the student's actions.

Everything is drawn and computed on the batch's device, the GPU.
"""

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

MOST_SHIFT = 4
"""Largest shift in each direction, of 128 pixels."""
GAIN = 0.12
TINT = 0.06
LIFT = 0.08
"""Standard deviations of the log contrast, the log gain of each colour, and the brightness
offset."""
MOST_NOISE = 0.04
"""Greatest standard deviation of the noise on pixels; a picture's range is 2."""

CANONICAL_SHARE = 0.2
"""Share of the instructions that are the benchmark's own."""
MOST_WORDS_LOST = 0.25
MOST_PAIRS_LOST = 0.6
"""Largest shares of the words, and of the remaining pairs, that are dropped from an instruction,
which simulates words that never occur in training."""


class PictureChange(NamedTuple):
    """Changes to the two pictures of n frames."""

    shift: Tensor
    """[n, 2, 2] int64: rows and columns, pixels."""
    gain: Tensor
    """[n, 2, 1, 1, 3]: factor on each colour."""
    lift: Tensor
    """[n, 2, 1, 1, 1]: brightness offset."""
    noise: Tensor
    """[n, 2, 1, 1, 1]: standard deviation."""


def draw_changes(n: int, device: torch.device) -> PictureChange:
    """Draws changes for n frames."""
    shift = torch.randint(-MOST_SHIFT, MOST_SHIFT + 1, (n, 2, 2), device=device)
    contrast = GAIN * torch.randn(n, 2, 1, 1, 1, device=device)
    tint = TINT * torch.randn(n, 2, 1, 1, 3, device=device)
    lift = LIFT * torch.randn(n, 2, 1, 1, 1, device=device)
    noise = MOST_NOISE * torch.rand(n, 2, 1, 1, 1, device=device).square()
    return PictureChange(shift, (contrast + tint).exp(), lift, noise)


def changed(pictures: Tensor, change: PictureChange) -> tuple[Tensor, Tensor]:
    """Returns both cameras' changed pictures in the network's input format.

    Args:
        pictures: uint8 [n, 2, 128, 128, 3].

    Returns:
        Two tensors [n, 3, 128, 128], channels last in memory. Where a shift
        uncovers an edge, the picture's own edge is repeated.
    """
    n, device = len(pictures), pictures.device
    positions = torch.arange(PICTURE, device=device)
    sources = (positions + change.shift[:, :, :, None]).clamp(0, PICTURE - 1)
    frame = torch.arange(n, device=device)[:, None, None, None]
    camera = torch.arange(2, device=device)[None, :, None, None]
    shifted = pictures[frame, camera, sources[:, :, 0, :, None], sources[:, :, 1, None, :]]
    x = (shifted.float() / 127.5 - 1.0) * change.gain + change.lift
    x = (x + torch.randn_like(x) * change.noise).clamp(-1.0, 1.0).permute(0, 1, 4, 2, 3)
    return x[:, 0], x[:, 1]


class Wordings:
    """Many wordings of each task, as features on the batch's device."""

    def __init__(self, per_task: int, seed: int, device: torch.device, processes: int = 1) -> None:
        found = _all_features(per_task, seed, processes)
        longest = max(len(singles) for task in found for singles, _ in task)
        words = np.zeros((len(found), per_task, longest), np.int16)
        pairs = np.zeros((len(found), per_task, longest - 1), np.int16)
        lengths = np.zeros((len(found), per_task), np.int16)
        for at, task in enumerate(found):
            for number, (singles, doubles) in enumerate(task):
                words[at, number, : len(singles)] = singles
                pairs[at, number, : len(doubles)] = doubles
                lengths[at, number] = len(singles)
        self._words = torch.from_numpy(words).to(device)
        self._pairs = torch.from_numpy(pairs).to(device)
        self._lengths = torch.from_numpy(lengths).to(device)
        self._per_task = per_task

    def draw(self, task: Tensor) -> tuple[Tensor, Tensor]:
        """Draws a wording for each of n samples of tasks [n], some with words missing.

        Returns:
            Rows [n, w] int64, and a mask [n, w]: 1 where there is a feature.
        """
        n, device = len(task), task.device
        number = torch.randint(self._per_task, (n,), device=device)
        canonical = torch.rand(n, device=device) < CANONICAL_SHARE
        number = torch.where(canonical, 0, number)
        words, pairs = self._words[task, number], self._pairs[task, number]
        present = torch.arange(words.shape[1], device=device) < self._lengths[task, number, None]
        kept = present & _draw_kept(words, MOST_WORDS_LOST, canonical)
        pairs_kept = kept[:, 1:] & kept[:, :-1] & _draw_kept(pairs, MOST_PAIRS_LOST, canonical)
        mask = torch.cat([kept, pairs_kept], dim=1).float()
        return torch.cat([words, pairs], dim=1).long(), mask

    def canonical(self, task: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the benchmark's own instructions, in the form of ``draw``."""
        words, pairs = self._words[task, 0], self._pairs[task, 0]
        present = torch.arange(words.shape[1], device=task.device) < self._lengths[task, 0, None]
        pairs_present = present[:, 1:] & present[:, :-1]
        mask = torch.cat([present, pairs_present], dim=1).float()
        return torch.cat([words, pairs], dim=1).long(), mask


def _draw_kept(rows: Tensor, most_lost: float, whole: Tensor) -> Tensor:
    """Draws a mask of the features to keep: all features in rows that are ``whole`` and in half of
    the other rows; in the remaining rows, features are dropped at random."""
    n, device = len(rows), rows.device
    lost = most_lost * torch.rand(n, 1, device=device)
    lost = torch.where(whole[:, None] | (torch.rand(n, 1, device=device) < 0.5), 0.0, lost)
    return torch.rand(rows.shape, device=device) >= lost


Features = Sequence[tuple[list[int], list[int]]]


def _all_features(per_task: int, seed: int, processes: int) -> Sequence[Features]:
    work = partial(_features_of_task, per_task, seed)
    if processes == 1:
        return [work(task) for task in TASK_NAMES]
    with ProcessPoolExecutor(processes) as pool:
        return list(pool.map(work, TASK_NAMES))


def _features_of_task(per_task: int, seed: int, task: str) -> Features:
    return [features(text) for text in draw(task, per_task, seed)]
