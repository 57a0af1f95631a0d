"""The conformance check names each fault, with the remedy."""

import pathlib

import pytest

pytest.importorskip("mujoco")

from rollout_env import Settings, open_simulator  # noqa: E402
from rollout_env.check import check  # noqa: E402


@pytest.fixture(autouse=True)
def _faulty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(pathlib.Path(__file__).parent))


def settings(name: str, **changed: object) -> Settings:
    options = {"cameras": {"agentview": "render"}, "action": ["x", "y"], **changed}
    return Settings("gym", f"faulty:{name}()", **options)


@pytest.mark.parametrize(
    ("name", "finding", "text"),
    [
        ("Reacher", None, ""),
        ("Unseeded", "unseeded reset", "pass the seed on"),
        ("Random", "non-deterministic reset", "draw all randomness from the seed"),
        ("Chaotic", "non-deterministic step", "step with one seed and the same actions"),
        ("Drifting", "failed", "two observations differ in agentview though no step"),
        ("Growing", "failed", "not uint8 (4, 6, 3): give the environment one size"),
        ("Diverging", "failed", "reading `observation` holds NaN"),
        ("Silent", "failed", "name the key that reports success with --success"),
        ("Still", "frames or readings that do not move", "return the state after the step"),
        ("Raising", "raised", "the arm fell off"),
    ],
)
def test_a_fault_is_named(name: str, finding: str | None, text: str) -> None:
    found = list(check(lambda: open_simulator(settings(name))))
    assert [one.name for one in found] == ([finding] if finding else [])
    assert all(text in one.text for one in found)


@pytest.mark.parametrize(
    ("changed", "finding", "text"),
    [
        ({"action": []}, "unnamed actions", "2 of 2 numbers of an action have no meaning"),
        ({"action": ["x"]}, "unusable", "--action names 1 numbers, an action has 2"),
        ({"cameras": {"agentview": "top"}}, "unusable", "the observation has no `top`"),
        ({"cameras": {"agentview": "mujoco.top"}}, "unusable", "mujoco.top"),
        ({"state": {"eef_pos": "hand[0:3]"}}, "unusable", "the observation has no `hand`"),
        ({"keywords": {"size": 3}}, "unusable", "unexpected keyword argument 'size'"),
        ({"control_hz": 5000.0}, "control rate", "correct it with --control-hz"),
    ],
)
def test_an_option_that_does_not_fit_is_named(
    changed: dict[str, object], finding: str, text: str
) -> None:
    found = list(check(lambda: open_simulator(settings("Reacher", **changed))))
    assert finding in [one.name for one in found]
    assert any(text in one.text for one in found)


@pytest.mark.parametrize(("name", "reused"), [("Reacher", True), ("DrawnAtConstruction", False)])
def test_only_an_environment_whose_resets_repeat_is_reused(name: str, reused: bool) -> None:
    simulator = open_simulator(settings(name, reuse=True))
    assert simulator.description.reused is reused
    task = simulator.description.tasks[0].name
    digests = []
    for _ in range(2):
        simulator.reset(task, 5, {})
        digests.append(simulator.observe(simulator.description.cameras).digest())
    assert digests[0] == digests[1]
