"""``VectorEnvironment``: seeds, autoreset modes, failures, snapshots and threads."""

import threading

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import rollout_libero

from .conftest import diverge, open_the_drawer


def actions(environments, seed=0):
    return np.random.default_rng(seed).uniform(-0.6, 0.6, (environments.num_envs, 7))


def assert_same(first, second):
    assert first.keys() == second.keys()
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name], err_msg=name)


def test_environments_equal_single_environments_on_any_number_of_threads(make, make_vector):
    tasks = ["libero_goal/0", "libero_object/1"]
    runs = []
    for threads in (1, 3):
        environments = make_vector(tasks, 4, threads=threads, init_states=[5])
        environments.reset(seed=1)
        for seed in range(3):
            observation, *_ = environments.step(actions(environments, seed))
        runs.append(observation)
        assert observation["agentview"].shape == (4, 64, 80, 3)
        assert environments.observation_space.contains(observation)
    assert_same(*runs)
    alone = make(tasks[1], init_states=[5])
    alone.reset()
    for seed in range(3):
        observation, *_ = alone.step(actions(environments, seed)[1])
    assert_same({name: values[1] for name, values in runs[0].items()}, observation)


def test_environments_of_a_task_get_different_initial_states(make_vector):
    environments = make_vector(num_envs=4, init_states="cycle", cameras=[])
    states = [environments.reset()[1]["init_state"].tolist() for _ in range(2)]
    assert states == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert environments.reset(seed=11)[1]["init_state"].tolist() == [11, 12, 13, 14]
    assert environments.reset()[1]["init_state"].tolist() == [15, 16, 17, 18]
    # A seed in a list selects the same initial state as in a single environment.
    assert environments.reset(seed=[3, 3, 9, None])[1]["init_state"].tolist() == [3, 3, 9, 22]
    # Each task has its own sequence of states.
    tasks = ["libero_goal/0", "libero_object/1", "libero_goal/0"]
    several = make_vector(tasks, 6, init_states="cycle", cameras=[])
    assert several.reset()[1]["init_state"].tolist() == [0, 0, 1, 2, 1, 3]
    assert several.reset()[1]["init_state"].tolist() == [4, 2, 5, 6, 3, 7]
    assert several.reset(seed=20)[1]["init_state"].tolist() == [20, 20, 21, 22, 21, 23]


def test_every_environment_has_its_own_seed(make_vector):
    environments = make_vector(num_envs=3, init_states="random")
    states = environments.reset(seed=[4, 5, 4])[1]["init_state"]
    again = environments.reset(seed=[4, 5, 4])[1]["init_state"]
    assert states.tolist() == again.tolist() and states[0] == states[2]
    numbered = environments.reset(seed=4)[1]["init_state"]
    assert numbered[:2].tolist() == states[:2].tolist()


def test_next_step_mode_begins_a_rollout_in_the_following_step(make_vector):
    environments = make_vector(num_envs=2, init_states=[0, 1])
    assert environments.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    environments.reset()
    open_the_drawer(environments.simulations[1])
    _, rewards, terminated, truncated, infos = environments.step(actions(environments))
    assert rewards.tolist() == [0, 1] and terminated.tolist() == [False, True]
    assert not truncated.any() and infos["steps"].tolist() == [1, 1]
    observation, rewards, terminated, _, infos = environments.step(actions(environments))
    assert rewards.tolist() == [0, 0] and not terminated.any()
    assert infos["steps"].tolist() == [2, 0] and infos["init_state"].tolist() == [0, 1]
    first = make_vector(num_envs=1, init_states=[1]).reset()[0]
    assert_same({name: values[1] for name, values in observation.items()},
                {name: values[0] for name, values in first.items()})


def test_same_step_mode_begins_a_rollout_and_returns_the_last_observation(make_vector):
    environments = make_vector(
        num_envs=2, init_states=[0, 1], autoreset_mode=AutoresetMode.SAME_STEP
    )
    environments.reset()
    open_the_drawer(environments.simulations[0])
    observation, rewards, terminated, _, infos = environments.step(actions(environments))
    assert rewards.tolist() == [1, 0] and terminated.tolist() == [True, False]
    assert infos["_final_obs"].tolist() == [True, False] and infos["final_obs"][1] is None
    last = infos["final_obs"][0]
    assert not np.array_equal(last["agentview"], observation["agentview"][0])
    assert infos["steps"].tolist() == [0, 1]
    assert infos["final_info"]["success"].tolist() == [True, False]
    environments.step(actions(environments))


@pytest.mark.parametrize("refused", [np.full((2, 7), np.nan), np.zeros((2, 6)), "render"])
def test_a_refused_action_at_an_autoreset_changes_nothing(make_vector, refused):
    environments = make_vector(num_envs=2, init_states="cycle", cameras=[])
    environments.reset()
    open_the_drawer(environments.simulations[1])
    *_, terminated, _, _ = environments.step(actions(environments))
    assert terminated.tolist() == [False, True]
    with pytest.raises(ValueError, match=r"read actions|step with actions|draw"):
        if isinstance(refused, str):
            environments.step_chunk(actions(environments)[:, None], refused)
        else:
            environments.step(refused)
    _, rewards, terminated, _, infos = environments.step(actions(environments))
    assert rewards.tolist() == [0, 0] and not terminated.any()
    assert infos["steps"].tolist() == [2, 0] and infos["init_state"].tolist() == [0, 3]


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_failing_environment_keeps_the_results_of_the_others(make_vector, mode):
    environments = make_vector(num_envs=3, init_states=[0], cameras=[], autoreset_mode=mode)
    alone = make_vector(num_envs=1, init_states=[0], cameras=[])
    environments.reset()
    alone.reset()
    diverge(environments.simulations[0])
    open_the_drawer(environments.simulations[2])
    chunk = np.full((3, 4, 7), 0.2)
    with pytest.raises(rollout_libero.SimulationError, match="control step") as raised:
        environments.step_chunk(chunk)
    assert raised.value.environments == [0]
    observation, rewards, terminated, truncated, infos = raised.value.result
    assert rewards.tolist() == [0, 0, 1] and terminated.tolist() == [False, False, True]
    assert not truncated.any() and infos["failed"].tolist() == [True, False, False]
    assert infos["taken"].tolist() == [0, 4, 1]
    expected, *_ = alone.step_chunk(chunk[:1])
    np.testing.assert_array_equal(observation["joint_pos"][1], expected["joint_pos"][0])
    if mode != AutoresetMode.NEXT_STEP:
        with pytest.raises(gymnasium.error.ResetNeeded, match=r"rollouts \[0"):
            environments.step_chunk(chunk)
        over = np.array([True, False, mode == AutoresetMode.DISABLED])
        environments.reset(options={"reset_mask": over})
    observation, _, terminated, _, infos = environments.step_chunk(chunk)
    assert infos["steps"][1] == 8 and not terminated.any()
    assert infos["taken"].tolist() == ([0, 4, 0] if mode == AutoresetMode.NEXT_STEP else [4] * 3)
    expected, *_ = alone.step_chunk(chunk[:1])
    np.testing.assert_array_equal(observation["joint_pos"][1], expected["joint_pos"][0])


def test_a_refused_snapshot_changes_no_environment(make_vector):
    environments = make_vector(num_envs=2, cameras=[])
    environments.reset(seed=0)
    snapshot = environments.snapshot()
    environments.step(actions(environments))
    mixed = make_vector(["libero_goal/0", "libero_object/0"], cameras=[], num_envs=2)
    mixed.reset()
    before = [simulation.state() for simulation in environments.simulations]
    fewer = snapshot._replace(simulations=snapshot.simulations[:1])
    for wrong, words in ((mixed.snapshot(), "another scene"), (fewer, "1 snapshots")):
        with pytest.raises(ValueError, match=words):
            environments.restore(wrong)
    for simulation, state in zip(environments.simulations, before, strict=True):
        np.testing.assert_array_equal(simulation.state(), state)
    assert environments.step(actions(environments))[-1]["steps"].tolist() == [2, 2]


def test_a_perturbation_takes_effect_at_the_next_rollout(make_vector):
    environments = make_vector(num_envs=2, init_states=[0], cameras=[])
    nominal = environments.reset()[1]["instruction"].tolist()
    environments.set_perturbation(1, "language/L2/c03")
    with pytest.raises(ValueError, match=r"valid|no such|for example"):
        environments.set_perturbation(1, "camrea/L2/c03")
    *_, infos = environments.step(actions(environments))
    assert infos["instruction"].tolist() == nominal
    instructions = environments.reset()[1]["instruction"]
    assert instructions[0] == nominal[0] and instructions[1] != nominal[1]


def test_without_autoreset_reset_mask_selects_environments(make_vector):
    environments = make_vector(num_envs=2, max_steps=2, autoreset_mode="Disabled")
    environments.reset()
    environments.reset(options={"reset_mask": np.array([True, False])})
    environments.step(actions(environments))
    *_, truncated, _ = environments.step(actions(environments))
    assert truncated.all()
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset_mask"):
        environments.step(actions(environments))
    environments.reset(options={"reset_mask": np.array([True, True])})
    environments.step(actions(environments))


def test_a_chunks_arrays_hold_the_executed_steps_and_zeros(make_vector):
    environments = make_vector(num_envs=2)
    environments.reset()
    open_the_drawer(environments.simulations[0])
    chunk = np.zeros((2, 3, 7))
    observation, *_, infos = environments.step_chunk(chunk, "all")
    assert infos["taken"].tolist() == [1, 3]
    frames = observation["agentview"]
    assert frames.shape == (2, 3, 64, 80, 3)
    assert frames[0, 0].any() and not frames[0, 1:].any() and frames[1, 2].any()


def test_the_first_observation_of_a_rollout_begun_in_a_chunk_replaces_the_last_one(make_vector):
    environments = make_vector(
        num_envs=2, init_states=[0, 1], autoreset_mode=AutoresetMode.SAME_STEP
    )
    environments.reset()
    open_the_drawer(environments.simulations[0])
    observation, *_, infos = environments.step_chunk(np.zeros((2, 3, 7)), "all")
    assert infos["taken"].tolist() == [1, 3] and infos["init_state"].tolist() == [0, 1]
    first = make_vector(num_envs=1, init_states=[0]).reset()[0]
    for name, values in observation.items():
        np.testing.assert_array_equal(values[0, 0], first[name][0], err_msg=name)
        assert not values[0, 1:].any() and values[1, 2].any()
    last = infos["final_obs"][0]["agentview"]
    assert last[0].any() and not np.array_equal(last[0], first["agentview"][0])


def test_a_snapshot_restores_all_environments(make_vector):
    environments = make_vector()
    environments.reset(seed=0)
    environments.step(actions(environments))
    snapshot = environments.snapshot()
    ends = []
    for _ in range(2):
        environments.restore(snapshot)
        environments.step(actions(environments, 1))
        ends.append(environments.step(actions(environments, 2))[0])
    assert_same(*ends)


def test_other_threads_run_while_environments_compute(make_vector):
    environments = make_vector(num_envs=2, height=256, width=256)
    environments.reset()
    done = threading.Event()

    def compute():
        environments.step_chunk(np.zeros((2, 10, 7)), "all")
        done.set()

    thread = threading.Thread(target=compute)
    thread.start()
    turns = 0
    while not done.is_set():
        turns += 1
    thread.join()
    # If the computation held the GIL, this thread would loop only once or twice.
    assert turns > 1000
