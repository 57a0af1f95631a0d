"""A policy's actions: the check of their shape, and the gripper conventions."""

from __future__ import annotations

import numpy as np

from .description import Description, Gripper
from .episode import UnderWay, UnusableObservation
from .processing.robot import gripper_from_rlds
from .proto import policy_pb2 as pb

ACTION_WIDTH = 7


class UnusableActions(ValueError):
    """A policy's answer is not a valid chunk of actions."""


def read_actions(answer: object, horizon: int) -> np.ndarray:
    """Checks a policy's answer and returns it as float32 [n, 7].

    Raises UnusableActions. Numbers beyond -1..1 are accepted: the worker clips
    them and counts them in the result."""
    if answer is None:
        raise UnusableActions("its infer returned nothing; end it with `return actions`")
    try:
        actions = np.atleast_2d(np.asarray(answer, dtype=np.float32))
    except (TypeError, ValueError) as error:
        raise UnusableActions(f"its answer is not an array of numbers: {error}") from error
    if actions.ndim != 2 or actions.shape[1] != ACTION_WIDTH:
        raise UnusableActions(f"its actions have shape {list(actions.shape)}, not [n, 7]")
    if not 1 <= len(actions) <= horizon:
        raise UnusableActions(f"it answered {len(actions)} actions; its horizon is {horizon}")
    if not np.isfinite(actions).all():
        row, column = np.argwhere(~np.isfinite(actions))[0]
        raise UnusableActions(f"component {column} of action {row} is {actions[row, column]}")
    return actions


def from_simulator(actions: np.ndarray, gripper: Gripper) -> np.ndarray:
    """Converts actions float32 [n, 7] from the simulator's gripper convention to `gripper`."""
    converted = actions.copy()
    if gripper is Gripper.RLDS:
        converted[:, -1] = (1 - converted[:, -1]) / 2
    elif gripper is Gripper.ZERO_OPENS:
        converted[:, -1] = (1 + converted[:, -1]) / 2
    elif gripper is not Gripper.MINUS_ONE_OPENS:
        converted[:, -1] *= -1
    return converted


def to_simulator(actions: np.ndarray, gripper: Gripper) -> np.ndarray:
    """Converts actions float32 [n, 7] from `gripper` to the simulator's
    convention: -1 open, 1 closed."""
    if gripper is Gripper.MINUS_ONE_OPENS:
        return actions
    if gripper is Gripper.RLDS:
        return gripper_from_rlds(actions).astype(np.float32)
    converted = actions.copy()
    converted[:, -1] *= -1
    if gripper is Gripper.ZERO_OPENS:
        # After the sign change the range is -1 (closed) to 0 (open); adding 1 gives RLDS's range.
        converted[:, -1] += 1
        return gripper_from_rlds(converted).astype(np.float32)
    return converted


def read_under_way(message: pb.InferRequest, description: Description) -> UnderWay | None:
    """Returns the actions that were scheduled when a query was sent; None if it holds none.

    Raises UnusableObservation if their shape is wrong."""
    if not message.HasField("under_way"):
        return None
    sent = message.under_way
    actions = np.array(sent.actions, dtype=np.float32)
    if sent.action_width != ACTION_WIDTH or actions.size % ACTION_WIDTH:
        raise UnusableObservation(
            f"the actions under way are {actions.size} numbers, {sent.action_width} per action, not"
            f" {ACTION_WIDTH}"
        )
    actions = from_simulator(actions.reshape(-1, ACTION_WIDTH), description.gripper)
    return UnderWay(actions, sent.delay)
