"""The example uses the pixels, and its actions go in the right direction."""

import numpy as np

from rollout_policies import Episode, Observation, State
from rollout_policies.examples.colour_servo import SIDE, WRIST, ColourServo

#: A hand that points down, with its x axis along the world's.
POINTING_DOWN = np.diag([1.0, -1.0, -1.0])


def upright_frame(row, column, size=12):
    """Returns a grey frame with a red square around a position."""
    frame = np.full((SIDE, SIDE, 3), 120, dtype=np.uint8)
    half = size // 2
    frame[row - half : row + half, column - half : column + half] = (200, 20, 20)
    return frame


def answer(upright, rotation=POINTING_DOWN):
    observation = Observation(
        Episode("s", "libero_object", "", 0),
        0,
        {WRIST: np.ascontiguousarray(upright[::-1])},
        {State.EEF_ROTATION: rotation.ravel()},
    )
    return ColourServo().infer(observation)


def test_the_hand_moves_towards_the_colour():
    far_up, right, left = upright_frame(10, 64), upright_frame(90, 118), upright_frame(90, 10)
    assert answer(far_up)[0] > 0.5  # up in the picture: the hand's x
    # Right in the picture is the hand's y axis, opposite to the world's.
    assert answer(right)[1] < -0.3 < 0.3 < answer(left)[1]
    turned = POINTING_DOWN @ np.diag([-1.0, -1.0, 1.0])
    assert answer(far_up, turned)[0] < -0.5


def test_the_hand_descends_when_centred_and_closes_around_the_colour():
    centred = answer(upright_frame(105, 64))
    assert centred[2] < 0 and centred[6] == -1
    assert answer(upright_frame(95, 64, size=48))[6] == 1


def test_the_hand_rises_open_if_the_frame_is_grey():
    action = answer(np.full((SIDE, SIDE, 3), 90, dtype=np.uint8))
    assert action[2] > 0 and action[6] == -1
