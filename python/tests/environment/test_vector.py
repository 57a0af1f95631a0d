"""``VectorEnvironment``: what ``test_state_machine`` does not compare: threads, turns of initial
states, frames of chunks, and the interpreter's lock."""

import threading

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from .conftest import open_the_drawer


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
        assert environments.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
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
    # A seed in a list selects the same initial state as in a single environment. The fourth has none
    # and takes its own next turn, four after 18.
    assert environments.reset(seed=[3, 3, 9, None])[1]["init_state"].tolist() == [3, 3, 9, 22]
    # Each task has its own sequence of states.
    tasks = ["libero_goal/0", "libero_object/1", "libero_goal/0"]
    several = make_vector(tasks, 6, init_states="cycle", cameras=[])
    assert several.reset()[1]["init_state"].tolist() == [0, 0, 1, 2, 1, 3]
    assert several.reset()[1]["init_state"].tolist() == [4, 2, 5, 6, 3, 7]
    assert several.reset(seed=20)[1]["init_state"].tolist() == [20, 20, 21, 22, 21, 23]


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
