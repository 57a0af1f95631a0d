"""Resizing and cropping of frames, as in the frameworks that policies were trained with.

Bilinear and Lanczos filters differ between frameworks in their sample positions, in widening when
they shrink, and in rounding; a network sees the difference. Frames are uint8 [height, width, 3]
throughout."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

#: A filter: its weight as a function of distance, in samples, and its radius.
Kernel = tuple[Callable[[np.ndarray], np.ndarray], float]


def _lanczos3(distance: np.ndarray) -> np.ndarray:
    return np.sinc(distance) * np.sinc(distance / 3)


def _triangle(distance: np.ndarray) -> np.ndarray:
    return 1 - np.abs(distance)


LANCZOS3: Kernel = (_lanczos3, 3.0)
BILINEAR: Kernel = (_triangle, 1.0)


def resize(frame: np.ndarray, height: int, width: int, kernel: Kernel) -> np.ndarray:
    """Resizes with a filter that is widened if it shrinks the frame (antialias).

    Equals `tf.image.resize(method="lanczos3", antialias=True)` and
    `torch.nn.functional.interpolate(mode="bilinear", antialias=True)`, each followed by rounding to
    the nearest and clipping to 0..255."""
    rows = _filter_matrix(frame.shape[0], height, kernel)
    columns = _filter_matrix(frame.shape[1], width, kernel)
    filtered = np.einsum("ys,sxc->yxc", rows, frame.astype(np.float32), optimize=True)
    filtered = np.einsum("xs,ysc->yxc", columns, filtered, optimize=True)
    return np.clip(np.round(filtered), 0, 255).astype(np.uint8)


def resize_bilinear(frame: np.ndarray, height: int, width: int) -> np.ndarray:
    """Resizes by linear interpolation between the two nearest samples, without antialiasing.

    Equals `torch.nn.functional.interpolate(mode="bilinear", align_corners=False)`, followed by
    rounding to the nearest."""
    values = frame.astype(np.float32)
    for axis, target in ((0, height), (1, width)):
        size = values.shape[axis]
        # Pixels are squares; positions beyond the outermost centres are clipped to them.
        centres = (np.arange(target, dtype=np.float32) + np.float32(0.5)) * np.float32(
            size / target
        )
        values = _interpolate(values, axis, np.clip(centres - np.float32(0.5), 0, size - 1))
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def _filter_matrix(size: int, target: int, kernel: Kernel) -> np.ndarray:
    """Returns the weight of every sample [size] in every result [target]; rows sum to 1."""
    weight_at, radius = kernel
    step = size / target
    # Pixels are squares: the centre of the first pixel is at one half.
    centres = (np.arange(target) + 0.5) * step
    samples = np.arange(size) + 0.5
    distance = (samples[None, :] - centres[:, None]) / max(step, 1.0)
    weights = np.where(np.abs(distance) <= radius, weight_at(distance), 0.0)
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)


def centre_crop(frame: np.ndarray, area: float, side: int) -> np.ndarray:
    """Crops the middle, `area` of the frame's area, and enlarges it to `side` x `side`.

    As in OpenVLA's evaluation: `tf.image.crop_and_resize`, bilinear with the outer samples on the
    outer edges of the crop, between two `convert_image_dtype`, of which the second multiplies by
    255.5 and drops the fraction."""
    scale = math.sqrt(area)
    values = frame.astype(np.float32) * np.float32(1 / 255)
    for axis in (0, 1):
        values = _sample_linearly(values, axis, (1 - scale) / 2, (1 + scale) / 2, side)
    return (np.clip(values, 0, 1) * np.float32(255.5)).astype(np.uint8)


def _sample_linearly(
    values: np.ndarray, axis: int, start: float, end: float, count: int
) -> np.ndarray:
    """Returns `count` values between two positions, given as fractions of the whole."""
    last = values.shape[axis] - 1
    return _interpolate(
        values, axis, np.linspace(start * last, end * last, count, dtype=np.float32)
    )


def _interpolate(values: np.ndarray, axis: int, positions: np.ndarray) -> np.ndarray:
    """Interpolates values at positions between samples, along one axis."""
    below = np.floor(positions).astype(int)
    above = np.ceil(positions).astype(int)
    shape = [1] * values.ndim
    shape[axis] = len(positions)
    share = (positions - below).reshape(shape)
    low, high = values.take(below, axis), values.take(above, axis)
    return low + (high - low) * share


def unit_planes(frame: np.ndarray) -> np.ndarray:
    """Returns float32 [3, height, width] in 0..1, as lerobot's policies take it."""
    return np.ascontiguousarray(frame.transpose(2, 0, 1)).astype(np.float32) / np.float32(255)
