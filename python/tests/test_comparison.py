"""Verdicts and tables of the RL comparison (python/bench/rl), from invented measurements. The arms
O, S and V are described in `compare.py`."""

import importlib
import sys
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Returns a function that imports a file of the comparison."""
    folder = Path(__file__).parents[1] / "bench" / "rl"
    monkeypatch.syspath_prepend(str(folder))
    yield importlib.import_module
    for name in ("checks", "compare", "report"):
        sys.modules.pop(name, None)


def replay(readings: list[float], success: int | None, contact: int | None = None) -> Any:
    return {
        "readings": [[reading] for reading in readings],
        "success": success,
        "contact": contact,
        "renderer": None,
    }


def test_motion_is_compared_until_the_first_contact(bench: Any) -> None:
    checks = bench("checks")
    theirs = replay([0.0, 1.0, 2.0], success=3, contact=3)
    assert checks.verdict(theirs, replay([0.0, 1.0, 2.5], 3))["same_motion"]
    verdict = checks.verdict(theirs, replay([0.0, 1.0 + 1e-8, 2.0], 3))
    assert not verdict["same_motion"]
    assert verdict["apart_before_contact"] == pytest.approx(1e-8)


@pytest.mark.parametrize(("ours", "is_same"), [(3, True), (5, True), (6, False), (None, False)])
def test_success_may_differ_by_two_steps(bench: Any, ours: int | None, is_same: bool) -> None:
    checks = bench("checks")
    verdict = checks.verdict(replay([0.0], success=3), replay([0.0], success=ours))
    assert verdict["same_success"] is is_same


def test_a_size_above_a_frameworks_limit_is_measured_once(bench: Any) -> None:
    sizes = bench("compare").sizes
    assert sizes([100, 200], ["rlinf", "simplevla"]) == [("rlinf", 50), ("simplevla", 16)]
    assert sizes([16, 50], ["simplevla", "rlinf"]) == [
        ("simplevla", 16),
        ("rlinf", 16),
        ("rlinf", 50),
    ]


def test_tables_have_medians_and_ranges(bench: Any) -> None:
    def run(arm: str, number: int, speed: float) -> dict[str, Any]:
        of_policy = {"none": {"steps_per_second": speed, "reset_s": 2.0}}
        scenario = {"framework": "rlinf", "task": "libero_goal/8", "environments": 16}
        measured = {"pss_mib": 10.0, "card_mib": None, "policies": of_policy}
        return {**scenario, "arm": arm, "round": number, **measured}

    runs = [run("O", 1, 100), run("V", 1, 900), run("O", 2, 120), run("V", 2, 1100)]
    failed = {"framework": "rlinf", "task": "libero_goal/8", "environments": 16, "arm": "S"}
    failed |= {"round": 1, "error": "status 1: no room"}
    table = bench("report").markdown({"machine": "m", "checks": {}, "runs": [*runs, failed]})
    assert "| none | O | 2 | 110 (100–120) | – | 2.00 (2.00–2.00) | – | 10 (10–10) | – |" in table
    assert "| none | V | 2 | 1,000 (900–1,100) |" in table
    assert "S, round 1, failed: status 1: no room" in table
