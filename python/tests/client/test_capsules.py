"""A campaign's capsules as starts: the environments are where the campaign's robot was."""

import json
import subprocess

import numpy as np
import pytest

from .conftest import specification

rollout_libero = pytest.importorskip("rollout_libero", reason="rollout_libero is not installed")

CONDITIONS = ("simultaneous", "actuation")
SETTINGS = {"assets": "primitives", "height": 32, "width": 32, "threads": 2}


@pytest.fixture(scope="module")
def capsules(programs, serve, connect, gateway, run, tmp_path_factory):
    """A file of two finished rollouts."""
    server = serve()
    client = connect(f"http://{server.address}")
    fields = {"axes": ["robot", "actuation"], "configs": [1], "record": "transitions"}
    run(server, client.create(specification("stored", f"http://{gateway.address}", **fields)))
    file = tmp_path_factory.mktemp("capsules") / "failures.capsules"
    subprocess.run(
        [programs / "coordinator", "jobs", "stored", "--connect", f"http://{server.address}",
         *(f"object/t0/{condition}/L1/c01" for condition in CONDITIONS), "--capsule", file],
        check=True,
    )  # fmt: skip
    return file


def position(capsule):
    return np.array(capsule.record["path"][capsule.steps]) / 10_000


def test_rollouts_begin_in_the_states_of_capsules(capsules):
    envs = rollout_libero.TrainingEnvironment(3, failures=capsules, **SETTINGS)
    whole = envs.failures[0]
    assert [one.row["axis"] for one in envs.failures] == list(CONDITIONS)
    assert whole.steps == len(whole.record["actions"]) and whole.max_steps == 280 - whole.steps
    starts = [whole.until(0), whole.until(whole.steps // 2), envs.failures[1]]
    observation = envs.reset(starts)
    for row, start in enumerate(starts):
        np.testing.assert_allclose(observation["eef_pos"][row], position(start), atol=6e-5)
    # The expert solves this task, so the rest of its actions succeeds under the perturbations.
    rest = np.float32(whole.record["actions"][whole.steps // 2 :])
    assert envs.step_chunk(rest[np.newaxis], rows=[1]).success[0, -1]
    envs.reset(seed=4)
    drawn = [start.steps for start in envs.starts]
    envs.reset(seed=4)
    assert drawn == [start.steps for start in envs.starts] and len(set(drawn)) == 3


def test_an_environment_of_gymnasium_begins_in_a_capsule(capsules):
    whole = rollout_libero.Capsule.read(capsules)[0]
    half = whole.until(whole.steps // 2)
    env = rollout_libero.Environment("libero_object/0", perturbation=half, **{
        name: value for name, value in SETTINGS.items() if name != "threads"
    })  # fmt: skip
    observation, info = env.reset(seed=0)
    np.testing.assert_allclose(observation["eef_pos"], position(half), atol=6e-5)
    assert (env.max_steps, info["instruction"]) == (280 - half.steps, whole.instruction)
    with pytest.raises(ValueError, match="it is of libero_object/0|configuration is of"):
        rollout_libero.Environment("libero_goal/0", assets="primitives", perturbation=half)


def test_a_wrong_capsule_is_named(capsules, tmp_path):
    first = json.loads(capsules.read_text().splitlines()[0])
    first["path"] = [[x + 30, y, z] for x, y, z in first["path"]]
    moved, broken = tmp_path / "moved", tmp_path / "broken"
    moved.write_text(json.dumps(first))
    broken.write_text(capsules.read_text() + "{}\n")
    envs = rollout_libero.TrainingEnvironment(1, failures=moved, **SETTINGS)
    with pytest.raises(ValueError, match="moves otherwise than in the capsule"):
        envs.reset()
    bddl, states = (
        f"{folder}/libero_object/pick_up_the_alphabet_soup_and_place_it_in_the_basket.{ending}"
        for folder, ending in (("bddl_files", "bddl"), ("init_files", "pruned_init"))
    )
    own = {"folder": "libero", "bddl": bddl, "states": states, "start": "initial-state",
           "seed": 0, "changes": {"view": [0, 0, 100, 0, 0], "noise": 2}}  # fmt: skip
    first["manifest_row"] |= {
        "rollout_id": "object/t0/plus:noise_2/i00", "axis": "variant", "level": "L0",
        "config": None, "init_slot": 0, "init_id": 0, "protocol": "plus-official", "own": own,
        "perturb": {},
    }  # fmt: skip
    moved.write_text(json.dumps(first))
    with pytest.raises(ValueError, match="LIBERO's own forty tasks"):
        rollout_libero.TrainingEnvironment(1, failures=moved, **SETTINGS).reset()
    with pytest.raises(ValueError, match="line 3: it is no capsule"):
        rollout_libero.TrainingEnvironment(1, failures=broken, **SETTINGS)
    with pytest.raises(ValueError, match="give starts, or make the environment with failures"):
        rollout_libero.TrainingEnvironment(1, **SETTINGS).reset()
