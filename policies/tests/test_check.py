"""`check` runs the gateway's check on a policy in this process. Synthetic observations."""

import numpy as np
import pytest
from conftest import Noisy, gateway_program

from rollout_policies import Camera, Description, DoesNotConform, State, check, fake_observation
from rollout_policies.processing.robot import axis_angle


class LiberoGoalOnly(Noisy):
    def reset(self, episode):
        assert episode.suite == "libero_goal" and "drawer" in episode.instruction


def test_a_violated_point_is_named_and_the_suite_is_the_callers():
    gateway_program()
    with pytest.raises(DoesNotConform, match="AssertionError"):
        check(LiberoGoalOnly())
    assert "does not conform" not in check(LiberoGoalOnly(), suite="libero_goal")


# Tests of synthetic observations.

ALL_INPUTS = Description(
    name="everything",
    cameras=(Camera("agentview", 64, 48), Camera("robot0_eye_in_hand", 5, 3)),
    state=tuple(State),
)


def test_a_synthetic_observation_has_the_requested_shape():
    synthetic = fake_observation(ALL_INPUTS)
    assert {name: frame.shape for name, frame in synthetic.images.items()} == {
        "agentview": (48, 64, 3),
        "robot0_eye_in_hand": (3, 5, 3),
    }
    assert all(frame.dtype == np.uint8 for frame in synthetic.images.values())
    assert len(synthetic.vector()) == sum(field.size for field in State)
    # In SI units, the readings of LIBERO's robot are below 4.
    assert all(np.abs(reading).max() < 4 for reading in synthetic.state.values())


def test_synthetic_observations_depend_on_seed_and_query():
    def bytes_of(*seed_and_query):
        synthetic = fake_observation(ALL_INPUTS, *seed_and_query)
        return synthetic.images["agentview"].tobytes() + synthetic.vector().tobytes()

    assert bytes_of(1, 2) == bytes_of(1, 2)
    assert len({bytes_of(1, 2), bytes_of(1, 3), bytes_of(2, 2)}) == 3


def test_synthetic_readings_describe_one_posture():
    state = fake_observation(ALL_INPUTS, 5).state
    x, y, z, w = quaternion = state[State.EEF_QUAT_XYZW]
    assert np.linalg.norm(quaternion) == pytest.approx(1)
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    assert state[State.EEF_ROTATION].reshape(3, 3) == pytest.approx(np.array(rotation))
    assert state[State.EEF_AXIS_ANGLE] == pytest.approx(axis_angle(quaternion))
    # The fingers point down.
    assert state[State.EEF_ROTATION][8] == pytest.approx(-1)
