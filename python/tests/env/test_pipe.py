"""The pipe returns what the environment returns, and names what ended it."""

import os
import pathlib
import sys

import numpy as np
import pytest

pytest.importorskip("mujoco")

from rollout_env import Client, Failed, Lost, Settings, Unusable, open_simulator  # noqa: E402
from rollout_env.description import Camera  # noqa: E402

FOLDER = pathlib.Path(__file__).parent
CAMERAS = [Camera("agentview", 6, 4)]
STEP = [[0.5, -0.5]]


@pytest.fixture(autouse=True)
def _faulty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(FOLDER), *sys.path]))


def client(name: str, *options: str) -> Client:
    spec = ["serve", f"gym:{name}", "--camera", "agentview=render", "--action", "x,y", *options]
    return Client([sys.executable, "-m", "rollout_env", *spec])


def test_a_rollout_through_the_pipe_equals_one_in_process() -> None:
    simulator = open_simulator(Settings("gym", "faulty:Reacher()", cameras={"agentview": "render"}))
    with client("faulty:Reacher()") as pipe:
        task = pipe.description["tasks"][0]
        assert task == {"name": "Reacher", "instruction": "reacher", "max_steps": 30}
        assert pipe.description["packages"].keys() >= {"gymnasium", "mujoco", "numpy"}
        simulator.reset("Reacher", 3, {})
        started = pipe.reset("Reacher", 3, CAMERAS)
        assert started["digest"] == simulator.observe(CAMERAS).digest()
        for count in (1, 3):
            answer = pipe.step(STEP * count)
            for _ in range(count):
                simulator.step(np.array(STEP[0]))
            seen = simulator.observe(CAMERAS)
            assert answer["executed"] == count and not answer["ended"]
            assert answer["state"]["observation"] == seen.state["observation"].tolist()
            frame = pipe.frames()["agentview"]
            assert frame.any() and (frame == seen.frames["agentview"][::-1]).all()
        assert pipe.step(STEP * 40)["executed"] == 26
        with pytest.raises(Failed, match="send reset first"):
            pipe.step(STEP)


@pytest.mark.parametrize(
    ("name", "kind", "text"),
    [
        ("faulty:Raising()", Failed, "step raised RuntimeError\\('the arm fell off'\\)"),
        ("faulty:Growing()", Failed, "give the environment one size"),
        ("faulty:Diverging()", Failed, "the simulation diverged"),
        ("faulty:Crashing()", Lost, "the process ended with -6 before it answered step"),
        ("faulty:Hanging()", Lost, "step was not answered in 2 s"),
    ],
)
def test_what_ends_a_rollout_is_named(name: str, kind: type[Exception], text: str) -> None:
    with client(name) as pipe:
        task = pipe.description["tasks"][0]["name"]
        pipe.reset(task, 3, CAMERAS)
        pipe.timeout = 2 if "Hanging" in name else pipe.timeout
        with pytest.raises(kind, match=text):
            pipe.step(STEP * 5)
        if kind is Failed:
            # The process serves the next rollout.
            pipe.reset(task, 3, CAMERAS)


@pytest.mark.parametrize(
    ("name", "options", "text"),
    [
        ("no_such_simulator:Task-v0", [], "needs a package: No module named 'no_such_simulator'"),
        ("Reacher-v77", [], "Reacher-v77"),
        ("faulty:Reacher()", ["--action", "x,x"], "--action has `x`"),
    ],
)
def test_an_environment_that_cannot_be_served_is_named(
    name: str, options: list[str], text: str
) -> None:
    with pytest.raises(Unusable, match=text):
        client(name, *options)


def test_rows_that_the_simulator_cannot_run_are_refused() -> None:
    with client("faulty:Reacher()") as pipe:
        for text, task, cameras, perturb in [
            ("no task `Pusher`; it has: Reacher", "Pusher", [], {}),
            ("no axis `lighting`; it has: none", "Reacher", [], {"lighting": {}}),
            ("no camera `wrist`; it has: agentview", "Reacher", [Camera("wrist", 6, 4)], {}),
            ("draws 6×4, not 64×64", "Reacher", [Camera("agentview", 64, 64)], {}),
        ]:
            with pytest.raises(Failed, match=text):
                pipe.reset(task, 0, cameras, perturb)
        with pytest.raises(Unusable, match="install the rollout-env of the worker's release"):
            pipe.call("describe", protocol=2, frames="")
        with pytest.raises(Failed, match="an action has 3 numbers, 2 are described"):
            pipe.reset("Reacher", 0, [])
            pipe.step([[0.0, 0.0, 0.0]])
