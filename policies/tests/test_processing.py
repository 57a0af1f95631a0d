"""Frames, readings and actions against the results of the upstream definitions.

Numbers that a framework defines were printed by the framework for the frame of `pattern`:
TensorFlow 2.15.1 and PyTorch 2.7.1, on x86-64."""

import hashlib
import math

import numpy as np
import pytest

from rollout_policies.adapters.openvla_oft import frame
from rollout_policies.adapters.univla import study_frame
from rollout_policies.processing import images, jpeg
from rollout_policies.processing.actions import Ensemble, from_bounds, within_bounds
from rollout_policies.processing.robot import axis_angle, gripper_from_rlds


def pattern(side):
    """A frame of curved stripes, different in each colour."""
    y, x = np.mgrid[0:side, 0:side]
    planes = [7 * x + 3 * y * y, x * x + 11 * y, 5 * x * y + 40]
    return np.stack([plane % 256 for plane in planes], axis=-1).astype(np.uint8)


def test_lanczos_shrinks_as_tensorflow_with_antialias():
    assert images.resize(pattern(8), 5, 5, images.LANCZOS3)[..., 0].tolist() == [
        [3, 14, 25, 36, 47],
        [13, 24, 35, 46, 58],
        [38, 50, 61, 72, 83],
        [81, 92, 103, 115, 126],
        [137, 148, 159, 171, 182],
    ]


def test_lanczos_enlarges_as_tensorflow():
    assert images.resize(pattern(8), 11, 11, images.LANCZOS3)[3, :4].tolist() == [
        [12, 22, 39],
        [16, 23, 45],
        [22, 24, 54],
        [27, 27, 61],
    ]


def test_bilinear_shrinks_as_torch_with_antialias():
    assert images.resize(pattern(8), 5, 5, images.BILINEAR)[..., 2].tolist() == [
        [41, 44, 47, 50, 53],
        [44, 59, 74, 89, 103],
        [47, 74, 101, 129, 155],
        [50, 89, 129, 169, 207],
        [53, 103, 155, 207, 168],
    ]


def test_the_centre_crop_is_tensorflows():
    assert images.centre_crop(pattern(8), 0.9, 6)[..., 1].tolist() == [
        [2, 4, 10, 19, 32, 48],
        [16, 19, 24, 34, 47, 63],
        [31, 33, 39, 48, 61, 78],
        [46, 48, 54, 63, 76, 92],
        [60, 63, 68, 78, 91, 107],
        [75, 77, 83, 92, 105, 121],
    ]


def test_plain_shrinking_equals_torch_without_antialias():
    # These numbers and the next ones are from PyTorch 2.11.0.
    assert images.resize_bilinear(pattern(8), 5, 5)[..., 2].tolist() == [
        [40, 43, 45, 48, 50],
        [43, 58, 73, 88, 104],
        [45, 73, 101, 129, 157],
        [48, 88, 129, 170, 211],
        [50, 104, 157, 211, 139],
    ]
    assert images.resize_bilinear(pattern(8), 11, 11)[3, :4].tolist() == [
        [13, 22, 40],
        [17, 23, 46],
        [22, 24, 53],
        [27, 27, 61],
    ]


def test_univlas_frames_in_the_study_are_cropped_to_whole_pixels():
    study_pixels = study_frame(pattern(256))
    assert study_pixels.shape == (224, 224, 3)
    assert study_pixels[100, :3].tolist() == [[90, 46, 132], [98, 28, 188], [105, 42, 161]]
    assert study_pixels[223, 223].tolist() == [133, 232, 98]
    # Upstream's own preparation gives other pixels.
    assert (study_pixels != frame(pattern(256))).mean() > 0.5


@pytest.mark.parametrize(
    ("side", "sha256"),
    [
        (32, "a1afc92175dc7d302493e700745e5e40bf9548cca0078e9afab8f6a4ff597937"),
        (256, "aa84d65ea01646a44f261da896b150024442ef63dc532e17b56e029b773a846d"),
    ],
)
def test_the_jpeg_round_trip_is_tensorflows_to_the_last_bit(side, sha256):
    restored = jpeg.round_trip(pattern(side))
    assert hashlib.sha256(restored.tobytes()).hexdigest() == sha256


def test_a_frame_with_a_side_that_is_no_multiple_of_16_is_refused():
    with pytest.raises(ValueError, match="20x16"):
        jpeg.round_trip(np.zeros((16, 20, 3), dtype=np.uint8))


def test_frames_become_planes_between_0_and_1():
    planes = images.unit_planes(pattern(8))
    assert planes.shape == (3, 8, 8) and planes.dtype == np.float32
    assert planes[2, 0, 0] == np.float32(40 / 255)


@pytest.mark.parametrize(
    ("quaternion", "expected"),
    [
        ([0.0, 0.0, 0.0, 1.0], [0, 0, 0]),
        # 2 acos(0.8), and the opposite rotation, whose angle about the same axis is 2 pi minus it.
        ([0.6, 0.0, 0.0, 0.8], [2 * math.acos(0.8), 0, 0]),
        ([0.6, 0.0, 0.0, -0.8], [2 * math.pi - 2 * math.acos(0.8), 0, 0]),
        # A hand that points down, as LIBERO's does.
        ([1.0, 0.0, 0.0, 0.0], [math.pi, 0, 0]),
        # Rounding may make w greater than 1.
        ([0.0, 0.0, 0.0, 1.0 + 1e-9], [0, 0, 0]),
    ],
)
def test_axis_angles_equal_robosuites_and_keep_the_quaternions_sign(quaternion, expected):
    assert axis_angle(np.array(quaternion)) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("from_rlds", "commanded"), [(0.0, 1), (0.2, 1), (0.5, 0), (0.9, -1), (1, -1)]
)
def test_a_gripper_of_rlds_is_converted(from_rlds, commanded):
    chunk = np.zeros((2, 7))
    chunk[:, :6] = 0.3
    chunk[:, 6] = from_rlds
    converted = gripper_from_rlds(chunk)
    assert (converted[:, 6] == commanded).all()
    assert (converted[:, :6] == 0.3).all() and chunk[0, 6] == from_rlds


def test_scaling_by_bounds_is_invertible_and_respects_the_mask():
    low, high, mask = [-2.0, 0.0, -1.0], [4.0, 1.0, 1.0], [True, True, False]
    world = np.array([-2.0, 0.75, 0.4])
    scaled = within_bounds(world, low, high, mask)
    assert scaled == pytest.approx([-1, 0.5, 0.4], abs=1e-7)
    assert from_bounds(scaled, low, high, mask) == pytest.approx(world, abs=1e-7)
    # Values beyond the percentiles are clipped on input, as in training.
    assert within_bounds(np.array([9.0, -3.0, 5.0]), low, high, mask).tolist() == [1, -1, 1]


def test_the_ensemble_averages_the_chunks_actions_for_the_current_step():
    ensemble = Ensemble(decay=0.1)
    first = np.arange(3)[:, None] + np.zeros(7)  # actions of zeros, ones and twos
    assert ensemble.add(first)[0] == 0
    second = 10 + first
    older = math.exp(-0.1)
    assert ensemble.add(second)[0] == pytest.approx((10 + older * 1) / (1 + older))
    third = 20 + first
    oldest = math.exp(-0.2)
    expected = (20 + older * 11 + oldest * 2) / (1 + older + oldest)
    assert ensemble.add(third)[0] == pytest.approx(expected)
    # The first chunk had three actions, so it does not cover the fourth step.
    fourth = 30 + first
    expected = (30 + older * 21 + oldest * 12) / (1 + older + oldest)
    assert ensemble.add(fourth)[0] == pytest.approx(expected)
    assert len(ensemble.chunks) == 3
