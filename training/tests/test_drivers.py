"""The choice of the driver, and the numbers that are added to the expert's actions."""

import numpy as np
import pytest

pytest.importorskip("torch", reason="PyTorch is not installed")

from training.drivers import AlternatingDrivers, ExpertDriver
from training.shards import Driver

N = 200


def test_a_fifth_of_the_experts_episodes_is_clean() -> None:
    drives = ExpertDriver(N, np.random.default_rng(0))
    drives.begin(np.arange(N))
    commands = [drives.next(3) for _ in range(100)]
    actions = np.concatenate([command.actions for command in commands], axis=1)
    assert actions.shape == (N, 300, 7) and all(command.expert.all() for command in commands)
    clean = drives.driver == Driver.CLEAN
    assert 0.1 < clean.mean() < 0.3
    assert not actions[clean].any()
    assert not actions[..., 6].any(), "the gripper is the expert's"
    is_quiet = ~actions[~clean].any(axis=2)
    assert 0.1 < is_quiet.mean() < 0.5


def test_a_push_is_one_direction_for_three_to_ten_steps() -> None:
    drives = ExpertDriver(N, np.random.default_rng(1))
    drives.begin(np.arange(N))
    commands = [drives.next(3) for _ in range(60)]
    actions = np.concatenate([command.actions for command in commands], axis=1)
    # Two equal steps are of a push, since noise differs at each step.
    again = actions[:, 1:].any(axis=2) & (actions[:, 1:] == actions[:, :-1]).all(axis=2)
    pushed = np.pad(again, [(0, 0), (0, 1)])
    assert pushed.any()
    assert np.abs(actions[pushed][:, :3]).max(axis=1).min() >= 0.49
    for row, mask in zip(actions, pushed, strict=True):
        starts = np.flatnonzero(mask & ~np.pad(mask, (1, 0))[:-1])
        for start in starts:
            same = (row[start:, :6] == row[start, :6]).all(axis=1)
            steps = len(same) if same.all() else int(np.argmin(same))
            assert 3 <= steps <= 10 or start + steps == len(row)


def test_the_student_is_queried_when_its_actions_are_used_up() -> None:
    drives = AlternatingDrivers(N, np.random.default_rng(2))
    drives.begin(np.arange(N))
    drives.driver[:] = Driver.STUDENT
    answered = np.zeros((N, 8, 7))
    since = np.zeros(N)
    for _ in range(100):
        needs_answer = drives.needs_answer()
        assert ((since >= 4) | (since == 0))[needs_answer].all() and (
            since[~needs_answer] < 8
        ).all()
        answers = np.random.default_rng(3).uniform(-1, 1, (int(needs_answer.sum()), 8, 7))
        drives.answer(needs_answer, answers)
        answered[needs_answer] = answers
        since[needs_answer] = 0
        commands = drives.next(4)
        assert not commands.expert.any()
        first = since.astype(int)
        for at in (0, N - 1):
            np.testing.assert_array_equal(
                commands.actions[at], answered[at, first[at] : first[at] + 4]
            )
        since += 4


def test_student_and_expert_take_turns() -> None:
    drives = AlternatingDrivers(N, np.random.default_rng(4))
    drives.begin(np.arange(N))
    by_student = []
    for _ in range(100):
        needs_answer = drives.needs_answer()
        drives.answer(needs_answer, np.ones((int(needs_answer.sum()), 8, 7)))
        commands = drives.next(4)
        by_student.append(~commands.expert[:, 0])
    turns = np.array(by_student)
    alone = drives.driver == Driver.STUDENT
    assert 0.1 < alone.mean() < 0.3 and turns[:, alone].all()
    assert 0.5 < turns[:, ~alone].mean() < 0.9
    assert (np.diff(turns[:, ~alone].astype(int), axis=0) != 0).any(axis=0).all()
