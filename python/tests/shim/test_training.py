"""From equal starts, `TrainingEnvironment` gives the same bits as the shim's environments."""

from typing import Any

import numpy as np
import pytest
from reference import put_into_basket

import rollout_libero
from libero.libero import benchmark
from libero.libero.envs import OffScreenRenderEnv
from rollout_libero.training import Start, TrainingEnvironment

SIZE = 32
SETTLING = [0.0] * 6 + [-1.0]
NAMES = {
    "agentview": "agentview_image",
    "robot0_eye_in_hand": "robot0_eye_in_hand_image",
    "eef_pos": "robot0_eef_pos",
    "eef_quat": "robot0_eef_quat",
    "joint_pos": "robot0_joint_pos",
    "gripper_pos": "robot0_gripper_qpos",
}


def task(suite: str, i: int) -> tuple[str, np.ndarray]:
    tasks = benchmark.get_benchmark(suite)()
    return tasks.get_task_bddl_file_path(i), tasks.get_task_init_states(i)


def started_in_shim(
    start: Start, settle_steps: int = 10, resets: int = 1
) -> tuple[OffScreenRenderEnv, Any]:
    """Returns an environment of the shim that was started as scripts start it, and its
    observation."""
    env = OffScreenRenderEnv(bddl_file_name=start.task, camera_heights=SIZE, camera_widths=SIZE)
    for _ in range(resets):
        env.seed(start.seed)
        from_shim = env.reset()
    if start.state is not None:
        from_shim = env.set_init_state(start.state)
    for _ in range(settle_steps):
        from_shim, *_ = env.step(SETTLING)
    return env, from_shim


def assert_same(observation: Any, row: int, from_shim: Any) -> None:
    for ours, theirs in NAMES.items():
        expected = from_shim[theirs]
        expected = expected[::-1, ::-1] if theirs.endswith("image") else expected
        np.testing.assert_array_equal(observation[ours][row], expected, err_msg=ours)


@pytest.fixture
def envs() -> Any:
    environment = TrainingEnvironment(3, height=SIZE, width=SIZE, threads=2)
    yield environment
    environment.close()


def test_rows_of_any_tasks_equal_scripts_environments(envs: TrainingEnvironment) -> None:
    # A task with a drawer, whose joint and position depend on the seed; a task with loose objects;
    # and a task of libero_90.
    tasks = [task("libero_goal", 0), task("libero_object", 3), task("libero_90", 44)]
    starts = [Start(file, states[7 + i], seed=20 + i) for i, (file, states) in enumerate(tasks)]
    shim = [started_in_shim(start) for start in starts]
    observation = envs.reset(starts)
    for row, (_, from_shim) in enumerate(shim):
        assert_same(observation, row, from_shim)
    chunk = np.random.default_rng(0).uniform(-1, 1, (3, 5, 7))
    stepped = envs.step_chunk(chunk)
    assert stepped.success.shape == (3, 5)
    for row, (env, _) in enumerate(shim):
        for action in chunk[row]:
            from_shim, *_ = env.step(action)
        assert_same(stepped.observation, row, from_shim)
    # Only the middle row gets a different task, which starts without a state.
    start = Start(task("libero_goal", 6)[0], seed=5, loads=3)
    observation = envs.reset([start], rows=[1])
    assert_same(observation, 0, started_in_shim(start, resets=2)[1])
    assert observation["agentview"].shape == (1, SIZE, SIZE, 3)
    assert observation["agentview"].flags.c_contiguous and observation["agentview"].flags.writeable
    # The other rows have not moved.
    stepped = envs.step_chunk(chunk[[2, 0], :2], rows=[2, 0], render="all")
    for index, row in enumerate((2, 0)):
        for step, action in enumerate(chunk[row, :2]):
            from_shim, *_ = shim[row][0].step(action)
            of_step = {name: values[:, step] for name, values in stepped.observation.items()}
            assert_same(of_step, index, from_shim)


def test_chunks_continue_past_success_and_report_it_per_step(envs: TrainingEnvironment) -> None:
    file, states = task("libero_object", 0)
    start = Start(file, states[0], seed=7)
    env, from_shim = started_in_shim(start)
    actions, expected = [], []
    for action, (after, _, done, _) in put_into_basket(env, from_shim):
        actions.append(action)
        expected.append(done)
        from_shim = after
    assert any(expected) and not expected[0], "the script did not put the object into the basket"
    envs.reset([start], rows=[0])
    successes = []
    for chunk in np.array(actions).reshape(-1, 8, 7):
        stepped = envs.step_chunk(chunk[None], rows=[0], render="none")
        successes += stepped.success[0].tolist()
        assert "agentview" not in stepped.observation
    assert successes == expected
    first = expected.index(True)
    assert len(expected) - first > 8, "too few steps follow the success"
    for name in ("eef_pos", "joint_pos"):
        np.testing.assert_array_equal(stepped.observation[name][0], from_shim[NAMES[name]])


def test_rows_with_equal_starts_settle_once_and_then_step_independently(
    envs: TrainingEnvironment, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, states = task("libero_goal", 8)
    group = Start(file, states[2], seed=3)
    counts: list[int] = []
    advance = envs._advance
    monkeypatch.setattr(
        envs, "_advance", lambda sims, *rest: counts.append(len(sims)) or advance(sims, *rest)
    )
    observation = envs.reset([group, Start(file, states[4], seed=3), group])
    assert counts == [2]
    for row, start in enumerate([group, Start(file, states[4], seed=3), group]):
        assert_same(observation, row, started_in_shim(start)[1])
    moves = np.random.default_rng(1).uniform(-1, 1, (3, 4, 7))
    stepped = envs.step_chunk(moves)
    alone = TrainingEnvironment(1, height=SIZE, width=SIZE)
    alone.reset([group])
    stepped_alone = alone.step_chunk(moves[2:])
    np.testing.assert_array_equal(
        stepped.observation["agentview"][2], stepped_alone.observation["agentview"][0]
    )
    assert (stepped.observation["eef_pos"][0] != stepped.observation["eef_pos"][2]).any()
    # A state in the middle of a rollout can be restored.
    before = alone.snapshot(0)
    after = [alone.step_chunk(moves[:1]).observation["eef_pos"] for _ in range(2)]
    alone.restore(0, before)
    np.testing.assert_array_equal(alone.step_chunk(moves[:1]).observation["eef_pos"], after[0])
    alone.close()


def test_settling_steps_and_action_are_configurable() -> None:
    file, states = task("libero_goal", 8)
    environment = TrainingEnvironment(
        1, height=SIZE, width=SIZE, settle_steps=15, settle_action=[0.0] * 7
    )
    observation = environment.reset([Start(file, states[1], seed=9)])
    env, _ = started_in_shim(Start(file, states[1], seed=9), settle_steps=0)
    for _ in range(15):
        from_shim, *_ = env.step([0.0] * 7)
    assert_same(observation, 0, from_shim)
    environment.close()


def test_a_refused_call_moves_no_row(envs: TrainingEnvironment) -> None:
    file, states = task("libero_goal", 8)
    with pytest.raises(ValueError, match="row 0: it has no rollout; call reset"):
        envs.step_chunk(np.zeros((3, 1, 7)))
    with pytest.raises(FileNotFoundError, match="nowhere.bddl"):
        envs.reset([Start(file), Start(file), Start("nowhere.bddl")])
    with pytest.raises(ValueError, match="failed to use row 0: it has no rollout"):
        envs.observe()
    envs.reset([Start(file, states[0])] * 3)
    for rows in ([], [0, 0], [3]):
        with pytest.raises(ValueError, match="choose rows"):
            envs.step_chunk(np.zeros((len(rows), 1, 7)), rows=rows)
    for shape in ((3, 7), (2, 1, 7), (3, 0, 7), (3, 1, 6)):
        with pytest.raises(ValueError, match="actions of shape"):
            envs.step_chunk(np.zeros(shape))
    with pytest.raises(ValueError, match="2 starts were given"):
        envs.reset([Start(file)] * 2)
    with pytest.raises(ValueError, match="is it of another task"):
        envs.reset([Start(file, states[0][:-1])], rows=[1])
    with pytest.raises(FileNotFoundError, match="nowhere.bddl"):
        envs.reset([Start("nowhere.bddl")], rows=[1])
    positions = envs.step_chunk(np.zeros((3, 1, 7))).observation["eef_pos"]
    undisturbed = TrainingEnvironment(1, height=SIZE, width=SIZE)
    undisturbed.reset([Start(file, states[0])])
    expected = undisturbed.step_chunk(np.zeros((1, 1, 7))).observation["eef_pos"]
    undisturbed.close()
    for position in positions:
        np.testing.assert_array_equal(position, expected[0])


def test_failed_rows_are_named_and_the_others_continue(envs: TrainingEnvironment) -> None:
    file, states = task("libero_goal", 8)
    envs.reset([Start(file, states[0])] * 3)
    diverging = states[0].copy()
    diverging[1:8] = 1e9  # rad: the physics diverges
    simulation = envs.simulations[1]
    assert simulation is not None
    simulation.set_state(diverging)
    with pytest.raises(rollout_libero.SimulationError) as caught:
        envs.step_chunk(np.zeros((3, 2, 7)))
    error: Any = caught.value
    assert error.environments == [1]
    assert error.result.observation["eef_pos"].shape == (3, 3)
    stepped = envs.step_chunk(np.zeros((2, 2, 7)), rows=[0, 2])
    assert np.isfinite(stepped.observation["eef_pos"]).all()
