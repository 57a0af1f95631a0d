"""Checkpoints without statistics, or with those of another robot, are refused."""

import json

import numpy as np
import pytest

from rollout_policies.adapters.prismatic import statistics_in
from rollout_policies.adapters.statistics import digest, require_statistics
from rollout_policies.adapters.upstream import UnusableCheckpoint

GOOD = {"q01": -np.ones(7), "q99": np.ones(7)}


def test_statistics_are_summarised_as_mode_and_digest():
    summary = require_statistics("actions", "QUANTILES", GOOD, 7)
    assert summary == f"actions QUANTILES {digest(GOOD)}" and len(digest(GOOD)) == 12
    assert digest({**GOOD, "q99": np.ones(7) * 2}) != digest(GOOD)
    assert require_statistics("actions", "IDENTITY", {}, 7) == "actions not normalised"


@pytest.mark.parametrize(
    ("mode", "statistics", "words"),
    [
        ("QUANTILES", {}, "no statistics of actions.* lacks q01 and q99"),
        ("MEAN_STD", GOOD, "lacks mean and std"),
        ("QUANTILES", {**GOOD, "q99": np.full(7, np.nan)}, "not finite"),
        ("QUANTILES", {"q01": np.zeros(7), "q99": np.zeros(7)}, "no spread"),
        ("MEAN_STD", {"mean": np.ones(7), "std": np.zeros(7)}, "no spread"),
        ("QUANTILES", {"q01": -np.ones(6), "q99": np.ones(6)}, "6 numbers, and LIBERO's are 7"),
        ("SOFTMAX", GOOD, "by SOFTMAX, an unknown mode"),
    ],
)
def test_invalid_statistics_are_refused_with_the_reason(mode, statistics, words):
    with pytest.raises(UnusableCheckpoint, match=words):
        require_statistics("actions", mode, statistics, 7)


def test_a_folder_without_statistics_of_the_suite_is_refused(tmp_path):
    with pytest.raises(UnusableCheckpoint, match="no dataset_statistics.json"):
        statistics_in(tmp_path, "libero_goal")
    file = tmp_path / "dataset_statistics.json"
    file.write_text(json.dumps({"bridge_orig": {}}))
    with pytest.raises(UnusableCheckpoint, match="no statistics of libero_goal"):
        statistics_in(tmp_path, "libero_goal")
    plain = {name: numbers.tolist() for name, numbers in GOOD.items()}
    for stored in ("libero_goal_no_noops", "libero_goal"):
        file.write_text(json.dumps({stored: {"action": plain}}))
        _, key, summary = statistics_in(tmp_path, "libero_goal")
        assert (key, summary) == (stored, f"{key}: actions QUANTILES {digest(GOOD)}")
