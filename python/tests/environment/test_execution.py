"""Under an execution model, rollouts of environments equal a campaign's rollouts of the same
policy."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import rollout_libero

from .conftest import TASK

HORIZON, EXECUTE = 10, 6
POLICIES = Path(__file__).parents[3] / "policies" / "src"
#: Answers with actions that depend on every bit of the hand's position. If one step differs, all
#: later steps differ.
ANSWER = f"""
import numpy as np

def answer(position):
    step, axis = np.arange({HORIZON})[:, None], np.arange(7)
    mixed = position[axis % 3] * 1e4 * (1.0 + axis + step)
    return (np.fmod(mixed, 1.0) * 0.9).astype(np.float32)
"""
SERVER = f"""
{ANSWER}
from rollout_policies import Description, Policy, State, serve

class HandPositionPolicy(Policy):
    description = Description(
        name="nervous", cameras=(), state=(State.EEF_POS,), horizon={HORIZON}, execute={EXECUTE}
    )

    def reset(self, episode):
        pass

    def infer(self, observation):
        return answer(observation.vector(State.EEF_POS))

serve(HandPositionPolicy())
"""
namespace: dict = {}
exec(ANSWER, namespace)
answer = namespace["answer"]


@pytest.fixture(scope="module")
def endpoint():
    """Address of a server of the policy in SERVER."""
    environment = {**os.environ, "PYTHONPATH": str(POLICIES)}
    server = subprocess.Popen(
        [sys.executable, "-u", "-c", SERVER], stdout=subprocess.PIPE, text=True, env=environment
    )
    line = server.stdout.readline()
    if not line.startswith("listening on "):
        server.kill()
        pytest.skip("the package for policies does not run here")
    yield "grpc://" + line.split()[2].rstrip(",")
    server.kill()
    server.wait()


@pytest.mark.parametrize("model", ["wait", "hold:2", "overlap:4", "overlap:7", "overlap:1*1+4*2"])
def test_an_execution_model_gives_a_campaigns_bits(
    make_vector, endpoint, programs, tmp_path, model
):
    rollout = "goal/t0/simultaneous/L2/c03"
    subprocess.run(
        [programs / "worker", "rollout", "--id", rollout, "--endpoint", endpoint,
         "--execution", model, "--no-video", "--assets", "primitives", "--output", tmp_path],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    trace = np.load(tmp_path / "trace.npz")

    environments = make_vector(
        num_envs=2, cameras=[], settle_steps=None, perturbation=[rollout, None],
        execution=model, execute=EXECUTE, autoreset_mode="Disabled",
    )  # fmt: skip
    observations, infos = environments.reset(seed=0)
    step, simulation = 0, environments.simulations[0]
    np.testing.assert_array_equal(observations["eef_pos"][0], trace["eef_pos"][0])
    while not environments.rollouts[0].is_over:
        if environments.rollouts[1].is_over:
            observations, infos = environments.reset(options={"reset_mask": [False, True]})
        answers = np.array([answer(position) for position in observations["eef_pos"]])
        observations, *_, infos = environments.step_chunk(answers)
        step += infos["taken"][0]
        qpos = simulation.data_array("qpos")
        np.testing.assert_array_equal(qpos, trace["qpos"][step], err_msg=f"step {step}")
    assert step == len(trace["qpos"]) - 1 > 100


def test_actions_under_way_are_reported_and_executed(make_vector):
    environments = make_vector(num_envs=1, cameras=[], execution="overlap:3,rtc", execute=5)
    observations, infos = environments.reset(seed=1)
    assert infos["delay"].tolist() == [3]
    hold = [0, 0, 0, 0, 0, 0, -1]
    assert infos["under_way"][0].tolist() == [hold] * 3
    first = answer(observations["eef_pos"][0])
    observations, *_, infos = environments.step_chunk(first[np.newaxis])
    assert infos["taken"].tolist() == [5]
    np.testing.assert_array_equal(infos["under_way"][0], first[5:])


def test_a_refused_chunk_changes_no_schedule_and_snapshots_include_it(make_vector):
    environments = make_vector(num_envs=1, cameras=[], execution="overlap:3", execute=5)
    observations, _ = environments.reset(seed=1)
    chunk = answer(observations["eef_pos"][0])[np.newaxis]
    with pytest.raises(ValueError, match="drops at least 3 actions of each answer"):
        environments.step_chunk(chunk[:, :3])
    with pytest.raises(ValueError, match="one of the numbers is NaN"):
        environments.step_chunk(np.full((1, HORIZON, 7), np.nan))
    with pytest.raises(ValueError, match="expert"):
        environments.step_chunk(chunk, expert=np.ones((1, HORIZON), bool))
    before = environments.snapshot()
    ends = []
    for _ in range(2):
        environments.restore(before)
        for _ in range(4):
            observations, *_, infos = environments.step_chunk(chunk)
        ends.append((infos["steps"].tolist(), observations["eef_pos"].tolist()))
    assert ends[0] == ends[1]


def test_a_row_sets_its_execution_model(make, make_vector):
    row = {**nominal_row(), "execution": "hold:2"}
    environments = make_vector(num_envs=1, cameras=[], perturbation=row)
    environments.reset()
    *_, infos = environments.step_chunk(np.zeros((1, 4, 7)))
    assert infos["taken"].tolist() == [6]
    with pytest.raises(ValueError, match="executes actions without delay"):
        make(perturbation=row)
    for options in ({"control": "absolute"}, {"execution": "dawdle:3"}, {"execute": 0}):
        with pytest.raises(ValueError, match="absolute|dawdle|execute 0"):
            make_vector(num_envs=1, perturbation=row, **options)
    with pytest.raises(ValueError, match="sampled"):
        make_vector(num_envs=1, init_states="sampled", execution="hold:1*1+2*1")


def nominal_row():
    return json.loads(rollout_libero._native.nominal_row(TASK, 3))


def test_a_schedule_works_without_an_environment():
    schedule = rollout_libero.Schedule("overlap:2", TASK, 0, execute=4)
    with pytest.raises(ValueError, match="a query is due"):
        schedule.advance()
    delay, under_way = schedule.due()
    assert (delay, under_way.shape) == (2, (2, 7))
    chunk = np.arange(56.0).reshape(8, 7) / 100
    schedule.answer(chunk)
    with pytest.raises(ValueError, match="none is due"):
        schedule.answer(chunk)
    duplicate = schedule.copy()
    executed = schedule.until_due()
    assert executed[:2, :6].tolist() == np.zeros((2, 6)).tolist()
    np.testing.assert_array_equal(executed[2:], chunk[2:4])
    np.testing.assert_array_equal([duplicate.advance() for _ in range(4)], executed)
