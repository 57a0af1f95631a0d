"""The robot's readings in the form that policies take, and the gripper conventions."""

from __future__ import annotations

import numpy as np

from ..description import State
from ..episode import Observation

#: Readings that `state_vector` needs.
STATE_FIELDS = (State.EEF_POS, State.EEF_QUAT_XYZW, State.GRIPPER_POS)


def axis_angle(quaternion: np.ndarray) -> np.ndarray:
    """Returns axis times angle, rad (3), of a quaternion x y z w.

    robosuite's `quat2axisangle`: the sign of the quaternion is kept, so angles reach up to two pi.
    Making w positive first would give other numbers for the same rotation, which did not occur in
    the policies' training."""
    w = np.clip(quaternion[3], -1.0, 1.0)
    length = np.sqrt(1.0 - w * w)
    if length == 0.0:
        return np.zeros(3)
    return np.asarray(quaternion[:3]) * (2.0 * np.arccos(w) / length)


def state_vector(observation: Observation) -> np.ndarray:
    """Returns the eight numbers of LIBERO policies' state, float64: position of the fingertip
    site (m), orientation as axis times angle (rad), the two finger joints (m)."""
    return np.concatenate(
        [
            observation.state[State.EEF_POS],
            axis_angle(observation.state[State.EEF_QUAT_XYZW]),
            observation.state[State.GRIPPER_POS],
        ]
    )


def gripper_from_rlds(actions: np.ndarray) -> np.ndarray:
    """Converts actions [.., 7] from a gripper of 0 closed, 1 open to LIBERO's:
    -1 open, 1 closed.

    OpenVLA's `normalize_gripper_action(binarize=True)`, then `invert_gripper_action`; exactly one
    half gives 0."""
    converted = np.array(actions, dtype=np.float64)
    converted[..., -1] = -np.sign(2 * converted[..., -1] - 1)
    return converted
