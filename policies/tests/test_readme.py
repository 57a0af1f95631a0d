"""The samples of the package's page run as they are printed."""

import pathlib
import re

import numpy as np
import pytest

import rollout_policies
from rollout_policies.proto import policy_pb2 as pb

PAGE = pathlib.Path(__file__).parent.parent / "README.md"


def samples():
    found = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found, f"{PAGE} has no sample in Python"
    return found


def look(camera):
    rgb = np.random.default_rng(5).bytes(camera.width * camera.height * 3)
    return pb.Image(camera=camera.name, width=camera.width, height=camera.height, rgb=rgb)


@pytest.mark.parametrize("sample", samples())
def test_a_sample_serves_a_policy_that_answers(sample, serving, monkeypatch):
    served = []
    # In place of serving for ever at an address that may be taken.
    monkeypatch.setattr(rollout_policies, "serve", lambda policy, _: served.append(policy))
    exec(compile(sample, str(PAGE), "exec"), {"__name__": "__main__"})
    [policy] = served
    client = serving(policy)
    described = client.describe()
    client.reset(instruction="put the milk in the basket", suite="libero_object")
    widths = {pb.STATE_FIELD_EEF_POS: 3, pb.STATE_FIELD_EEF_AXIS_ANGLE: 3}
    state = [
        pb.StateReading(field=field, values=[0.5] * widths.get(field, 2))
        for field in described.state
    ]
    observation = pb.Observation(images=map(look, described.cameras), state=state)
    actions = client.infer(observation=observation)
    assert actions.shape == (described.horizon, 7)
    assert np.abs(actions).max() <= 1.0
