"""Conversion of an environment's observations to the network's input."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from training.network import STATE
from training.text import features

Observation = Mapping[str, NDArray[Any]]
"""Observation of ``rollout_libero`` with ``orientation="upright"``: an array with n rows under
each name."""

CAMERAS = ("agentview", "robot0_eye_in_hand")
"""Cameras in the order of a frame's pictures."""
RENDERED = 256
"""Height and width of rendered pictures, at which the sensor axis applies its noise and blur."""


def shrink(pictures: Tensor) -> Tensor:
    """Halves height and width: a pixel becomes the rounded mean of four.

    Args:
        pictures: uint8 [..., 2h, 2w, channels].

    Returns:
        uint8 [..., h, w, channels]: (a + b + c + d + 2) / 4 of each 2 × 2 block."""
    height, width, channels = pictures.shape[-3:]
    blocks = pictures.view(*pictures.shape[:-3], height // 2, 2, width // 2, 2, channels)
    rows = blocks[..., 0, :, :, :].short() + blocks[..., 1, :, :, :]
    total = rows[..., 0, :] + rows[..., 1, :]
    return (total + 2).div_(4, rounding_mode="floor").byte()


def frames(observation: Observation, device: torch.device) -> Tensor:
    """Returns both cameras' pictures, uint8 [n, 2, 128, 128, 3] on the device, in the orientation
    of the observation. The student is trained on upright pictures."""
    views = [shrink(torch.from_numpy(observation[camera]).to(device)) for camera in CAMERAS]
    return torch.stack(views, dim=1)


def rotation(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Converts quaternions [n, 4], x y z w, to rotation matrices [n, 9], row by row."""
    x, y, z, w = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    return np.stack(
        [
            1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
            2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
            2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
        ],
        axis=1,
    )  # fmt: skip


def robot_state(observation: Observation) -> NDArray[np.float32]:
    """Returns the robot's state [n, 14]: position, rotation matrix of the hand, fingers."""
    position, fingers = observation["eef_pos"], observation["gripper_pos"]
    matrix = rotation(observation["eef_quat"])
    state = np.concatenate([position, matrix, fingers], axis=1, dtype=np.float32)
    assert state.shape[1] == STATE
    return state


def scaled(picture: Tensor) -> Tensor:
    """Scales bytes [n, h, w, 3] to -1 to 1, [n, 3, h, w], channels last in memory."""
    return picture.permute(0, 3, 1, 2).float() / 127.5 - 1.0


def instruction_rows(texts: Sequence[str]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Returns the features of n instructions, padded to the longest instruction: the features'
    rows, [n, w], and a mask [n, w] that is 1 where there is a feature."""
    by_text = [[*singles, *pairs] for singles, pairs in map(features, texts)]
    longest = max(1, *map(len, by_text))
    rows = np.zeros((len(by_text), longest), np.int64)
    present = np.zeros((len(by_text), longest), np.float32)
    for index, text_rows in enumerate(by_text):
        rows[index, : len(text_rows)] = text_rows
        present[index, : len(text_rows)] = 1.0
    return rows, present
