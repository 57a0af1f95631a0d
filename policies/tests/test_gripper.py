"""Meaning of the seventh number of an action."""

import logging

import numpy as np
import pytest
from conftest import Plain

from rollout_policies import Description, Gripper


@pytest.mark.parametrize(
    ("gripper", "opens", "closes"),
    [
        (Gripper.MINUS_ONE_OPENS, -1, 1),
        (Gripper.ONE_OPENS, 1, -1),
        (Gripper.RLDS, 1, 0),
        (Gripper.ZERO_OPENS, 0, 1),
    ],
)
def test_a_declared_gripper_convention_becomes_the_simulators(serving, gripper, opens, closes):
    class Gripping(Plain):
        description = Description(name="gripping", horizon=2, gripper=gripper)

        def infer(self, observation):
            return [[0.5] * 6 + [opens], [0.5] * 6 + [closes]]

    client = serving(Gripping())
    client.reset()
    assert client.infer().tolist() == [[0.5] * 6 + [-1.0], [0.5] * 6 + [1.0]]


@pytest.mark.parametrize(("gripper", "warnings"), [(0.5, 1), (-0.5, 0)])
def test_a_gripper_that_never_opens_is_logged_once(serving, caplog, gripper, warnings):
    class Closed(Plain):
        # Actions that are not executed do not count as opening.
        description = Description(name="closed", horizon=20, execute=10)

        def infer(self, observation):
            actions = np.zeros((20, 7))
            actions[9, 6] = gripper
            actions[10:, 6] = -1
            return actions

    client = serving(Closed())
    with caplog.at_level(logging.WARNING):
        for session in "abc":
            client.reset(session)
            for query_index in range(5):
                client.infer(session, query_index)
            client.end(session)
        # This episode has too few actions for a warning.
        client.reset("d")
        client.infer("d")
        client.end("d")
    warned = [record.getMessage() for record in caplog.records]
    assert len(warned) == warnings
    for text in warned:
        assert "'closed'" in text and "session 'a'" in text and "gripper=" in text
