"""The samples in the package's README run as printed."""

import pathlib
import re

import numpy as np
import pytest
from conftest import assert_conforms

import rollout_policies
from rollout_policies import fake_observation
from rollout_policies.fake import to_message

PACKAGE = pathlib.Path(__file__).parent.parent
PAGE = PACKAGE / "README.md"


def samples():
    programs = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert programs, f"{PAGE} has no sample in Python"
    return programs


@pytest.mark.parametrize("sample", samples())
def test_a_sample_serves_a_policy_that_answers(sample, serving, monkeypatch):
    served = []
    # Replaces `run`, which would serve until the process is stopped.
    monkeypatch.setattr(rollout_policies, "run", lambda policy_class: served.append(policy_class()))
    exec(compile(sample, str(PAGE), "exec"), {"__name__": "__main__"})
    [policy] = served
    client = serving(policy)
    described = client.describe()
    client.reset(instruction="put the milk in the basket", suite="libero_object")
    observation = to_message(fake_observation(policy.description))
    actions = client.infer(observation=observation)
    assert actions.shape == (described.horizon, 7)
    assert np.abs(actions).max() <= 1.0
    assert_conforms(policy)


def test_public_functions_named_in_the_readme_are_in_all():
    named = set(re.findall(r"`([A-Za-z_0-9]+)\(", PAGE.read_text(encoding="utf-8")))
    exported = {name for name in named if hasattr(rollout_policies, name)}
    assert {"check", "fake_observation", "resize", "Ensemble", "gripper_from_rlds"} <= exported
    assert set(rollout_policies.__all__) >= exported


def test_the_package_has_py_typed():
    assert (pathlib.Path(rollout_policies.__file__).parent / "py.typed").is_file()
    assert '"py.typed"' in (PACKAGE / "pyproject.toml").read_text(encoding="utf-8")
