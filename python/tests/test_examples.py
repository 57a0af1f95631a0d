"""The examples run unchanged, on the built-in assets."""

import re
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"

try:
    version("rollout-libero")
except PackageNotFoundError:
    pytest.skip("rollout-libero is not installed", allow_module_level=True)


@pytest.fixture
def run(python):
    """Runs an example, and returns what it printed."""

    def run_example(*words):
        done = python(*words)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run_example


def test_the_evaluation_prints_each_task_with_its_interval(run):
    tasks = ("libero_object/0", "libero_goal/1")
    printed = run(EXAMPLES / "evaluate.py", *tasks, "--episodes", 2, "--max-steps", 16,
                  "--assets", "primitives")
    lines = printed.splitlines()[1:]
    assert [line.split()[0] for line in lines] == [*tasks, "all"]
    for line in lines:
        successes, n, rate, low, high = map(float, re.findall(r"\d+\.?\d*", line.split(" ", 1)[1]))
        assert rate == pytest.approx(100 * successes / n, abs=0.1)
        assert low <= rate <= high and low < high
    # The upper ends of Wilson's intervals for 0 successes of 2 and of 4.
    ends = {line.split()[0]: line.split()[-1] for line in lines if " 0 of" in line}
    assert ends.get("libero_object/0", "65.8") == "65.8"
    assert ends.get("all", "49.0") == "49.0"


def test_collected_episodes_are_complete_and_reproducible(run, tmp_path):
    steps = 6
    for folder in ("once", "again"):
        printed = run(
            EXAMPLES / "collect.py", "libero_object/0", "libero_goal/1", "--num-envs", 3,
            "--assets", "primitives",
            "--episodes", 5, "--max-steps", steps, "--size", 32, "--seed", 3,
            "--output", tmp_path / folder,
        )  # fmt: skip
        assert "wrote 5 episodes" in printed
    names = sorted(path.name for path in (tmp_path / "once").iterdir())
    assert names == [f"episode_{index:05d}.npz" for index in range(5)]
    for name in names:
        with np.load(tmp_path / "once" / name) as once, np.load(tmp_path / "again" / name) as again:
            count = len(once["actions"])
            assert 1 <= count <= steps
            assert once["agentview"].shape == (count + 1, 32, 32, 3)
            assert once["agentview"].dtype == np.uint8
            assert once["actions"].shape == (count, 7)
            # An episode ends only once, at its last step.
            ended = once["terminated"] | once["truncated"]
            assert list(ended) == [False] * (count - 1) + [True]
            # The first observation is that of the reset, not the last of the previous episode.
            moved = np.linalg.norm(np.diff(once["eef_pos"], axis=0), axis=1)
            assert moved.max() < 0.1
            assert str(once["instruction"])
            for key in once.files:
                np.testing.assert_array_equal(once[key], again[key], err_msg=key)
