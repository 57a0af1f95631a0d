"""Calibration against a hand whose deviations are known in closed form."""

from typing import Any

import numpy as np
import pytest

from rollout_env import Unusable
from rollout_env.calibrate import calibrate
from rollout_env.description import Camera, Description, Observation, Step, Task

#: Metres per control step at a full action.
SPEED = 0.01
STEPS = 100


class Hand:
    """Moves by its actions, like a robot that tracks every displacement."""

    description = Description(
        "hand", [Task("move", "move", STEPS)], [], {"eef_pos": 3}, ["x", "y", "z"], 20.0, []
    )

    def reset(self, task: str, seed: int, perturb: dict[str, Any]) -> None:
        self.position = np.zeros(3)

    def step(self, action: np.ndarray) -> Step:
        self.position = self.position + SPEED * action
        return Step(False, False)

    def observe(self, cameras: list[Camera]) -> Observation:
        return Observation({}, {"eef_pos": self.position}, {"eef_pos": self.position})

    def close(self) -> None:
        pass


def test_sigma_is_an_eighth_of_the_value_that_deviates_by_20_mm() -> None:
    straight = np.tile([0.5, 0.0, 0.0], (STEPS, 1))
    found = calibrate(Hand(), {"move@0": straight}, "eef_pos", 1000.0)
    # 0.5 m in a straight line: a gain of 1.04 ends 20 mm further; a lag of τ steps ends τ steps
    # short, with τ · 5 mm in the limit.
    assert found["unit"]["gain_log2"] == pytest.approx(np.log2(1.04) / 8, rel=0.03)
    assert found["unit"]["lag_tau"] == pytest.approx(4 / 8, rel=0.03)
    assert found["demo_action_rms"] == [0.5, 0.0]
    assert found["demonstrations"] == {"move@0": STEPS}
    # Independent of the unit of length.
    halved = calibrate(Hand(), {"move@0": straight}, "eef_pos", 2000.0)
    assert halved["unit"]["lag_tau"] == pytest.approx(2 / 8, rel=0.03)
    assert all(halved["unit"][name] < value for name, value in found["unit"].items())
    with pytest.raises(Unusable, match="there is no reading `tcp`, but eef_pos"):
        calibrate(Hand(), {"move@0": straight}, "tcp", 1000.0)
