"""A policy that uses vision: it moves the gripper towards the most colourful
object that the wrist camera sees, and closes on it.

It uses only pixels and the hand's orientation, needs no weights, and shows how
a policy is written. It performs poorly: it reads no instruction, plans nothing
and solves almost no task.

    python -m rollout_policies.examples.colour_servo --listen 127.0.0.1:5000
"""

from __future__ import annotations

import numpy as np

from rollout_policies import Camera, Description, Episode, Language, Observation, Policy, State, run

WRIST = "robot0_eye_in_hand"
SIDE = 128
#: If no pixel has this saturation (0..1), the whole frame counts as grey.
LEAST_SATURATION = 0.25
#: Share of the frame's highest saturation that every pixel of the blob reaches.
BLOB_SHARE = 0.7
#: Side of the box over which the saturation is averaged, in pixels.
BOX = 9
#: Target position of the colour in the frame, in half-frames right of and above the middle: as low
#: as possible without being covered by the hand.
AIM = np.array([0.0, -0.5])
#: Commands per half-frame of offset, and the constant descent.
GAIN = 0.8
DESCENT = 0.25
#: The hand descends if the offset is smaller than this, in half-frames.
CENTRED = 0.35
#: Share of the frame's width that a blob spans when it is between the fingers.
GRASPABLE_WIDTH = 0.18


class ColourServo(Policy):
    """Serves a policy without weights that reaches for colours."""

    description = Description(
        name="colour-servo",
        checkpoint="example: no weights",
        cameras=(Camera(WRIST, SIDE, SIDE),),
        state=(State.EEF_ROTATION,),
        language=Language.IGNORED,
    )

    def reset(self, episode: Episode) -> None:
        """Does nothing: every answer depends only on its observation."""

    def infer(self, observation: Observation) -> np.ndarray:
        blob = find_blob(observation.upright(WRIST))
        if blob is None:
            return np.array([0, 0, 0.2, 0, 0, 0, -1])  # rise, to widen the view
        centre, width = blob
        offset = centre - AIM
        # In the hand's frame, x is up in the picture, y is right, and z is the direction of the
        # fingers.
        right, up = np.clip(GAIN * offset, -1, 1)
        ahead = DESCENT if np.abs(offset).max() < CENTRED else 0.0
        hand_to_world = observation.state[State.EEF_ROTATION].reshape(3, 3)
        translation = hand_to_world @ np.array([up, right, ahead])
        gripper = 1.0 if width > GRASPABLE_WIDTH else -1.0
        return np.concatenate([translation, np.zeros(3), [gripper]])


def find_blob(frame: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Finds the most saturated region of an upright RGB frame.

    Returns its centre in half-frames right of and above the middle, and the share of the frame's
    width that it spans; None if the whole frame is grey."""
    saturation = smooth(np.ptp(frame, axis=2) / 255.0)
    peak = saturation.max()
    if peak < LEAST_SATURATION:
        return None
    rows, columns = np.nonzero(saturation >= BLOB_SHARE * peak)
    height, width = saturation.shape
    right = (columns.mean() + 0.5) / width * 2 - 1
    up = 1 - (rows.mean() + 0.5) / height * 2
    return np.array([right, up]), len(np.unique(columns)) / width


def smooth(values: np.ndarray) -> np.ndarray:
    """Returns the mean over a box around each pixel, borders replicated."""
    padded = np.pad(values, BOX // 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (BOX, BOX))
    return windows.mean(axis=(2, 3))


if __name__ == "__main__":
    run(ColourServo)
