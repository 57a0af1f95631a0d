"""Observations and actions of an environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

Observation = dict[str, NDArray[np.generic]]
"""One entry for each camera: [height, width, 3], uint8, in the environment's orientation. Further
entries, float64, world frame: ``eef_pos`` [3], m, of the site between the fingertips; ``eef_quat``
[4], x y z w, of the hand; ``eef_axis_angle`` [3], rad, the same orientation; ``joint_pos``,
``joint_vel`` [7], rad and rad/s; ``gripper_pos``, ``gripper_vel`` [2], m and m/s, of the
fingers."""

Orientation = Literal["policy", "upright"]
"""The order of a frame's rows and columns. LIBERO's own arrays have row 0 at the bottom.

``"policy"``: LIBERO's array turned by 180°, ``raw[::-1, ::-1]``: row 0 is the top and column 0
the right. OpenVLA, openpi and most VLAs were trained on LIBERO's frames like this.
``"upright"``: ``raw[::-1]``, row 0 is the top and column 0 the left: the scene as a person
sees it. A policy trained on the other orientation sees a plausible, mirrored picture and
fails."""

Render = Literal["last", "all", "none"]
"""The steps of a chunk of which frames are rendered."""

CAMERAS = ("agentview", "robot0_eye_in_hand")
READINGS: Mapping[str, int] = {
    "eef_pos": 3, "eef_quat": 4, "eef_axis_angle": 3, "joint_pos": 7, "joint_vel": 7,
    "gripper_pos": 2, "gripper_vel": 2,
}  # fmt: skip
ACTION_WIDTH = 7


def observation_space(cameras: Sequence[str], height: int, width: int) -> spaces.Dict:
    frames = {camera: spaces.Box(0, 255, (height, width, 3), np.uint8) for camera in cameras}
    readings = {
        name: spaces.Box(-np.inf, np.inf, (length,), np.float64)
        for name, length in READINGS.items()
    }
    return spaces.Dict({**frames, **readings})


def action_space() -> spaces.Box:
    """Returns the space of actions: translation, rotation vector, gripper (-1 opens, 1 closes)."""
    return spaces.Box(-1.0, 1.0, (ACTION_WIDTH,), np.float32)


def is_absolute(control: str) -> bool:
    """Returns true if actions are poses. Raises ValueError if there is no such control."""
    return _is_second("control", control, "relative", "absolute")


def is_mirrored(orientation: str) -> bool:
    """Returns true if columns run from right to left. Raises ValueError if there is no such
    orientation."""
    return not _is_second("orientation", orientation, "policy", "upright")


def _is_second(name: str, given: str, first: str, second: str) -> bool:
    if given not in (first, second):
        raise ValueError(f"failed to choose {name} {given!r}: it is {first!r} or {second!r}")
    return given == second
