"""Collection from fake environments: observed, executed and stored values agree."""

import argparse
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="PyTorch is not installed")
libero = pytest.importorskip("rollout_libero", reason="rollout_libero is not installed")

from training import collect, pipeline
from training.shards import Driver, Outcome, Shard, read, shard_folders
from training.wordings import TASK_NAMES

LENGTHS = (7, 10)
"""Steps until success, of environments with even and with odd numbers."""
STUCK = 8
"""Step at which the expert makes no progress."""


class FakeEnvironments:
    """Fake environments, whose pictures and expert's actions encode the step."""

    max_steps = np.array([20, 20])

    def __init__(self, tasks: list[str], n: int, *_: Any, **settings: Any) -> None:
        assert settings["init_states"] == "sampled"
        assert settings["orientation"] == "upright"
        self.n = n
        self.step = np.zeros(n, np.int64)
        self.ended = np.zeros(n, bool)
        self.length = np.array([LENGTHS[index % 2] for index in range(n)])
        self.perturbed: list[Any] = [None] * n
        self.perturbed_next: list[Any] = [None] * n

    def reset(self, *, seed: list[int]) -> tuple[dict[str, Any], dict[str, Any]]:
        assert len(set(seed)) == self.n
        self.perturbed = list(self.perturbed_next)
        return self.observation(), {}

    def set_perturbation(self, index: int, chosen: str | libero.Capsule | None) -> None:
        assert not isinstance(chosen, libero.Capsule) or chosen.steps <= 12
        self.perturbed_next[index] = chosen

    def step_chunk(self, actions: Any, _render: str, *, expert: Any) -> tuple[Any, ...]:
        begins, k = self.ended.copy(), actions.shape[1]
        assert expert.shape == (self.n, k)
        for index in np.flatnonzero(begins):
            self.step[index], self.perturbed[index] = 0, self.perturbed_next[index]
        taken = np.where(begins, 0, np.minimum(k, self.length - self.step))
        self.step += taken
        self.ended = ~begins & (self.step == self.length)
        info = {"taken": taken}
        return self.observation(), None, self.ended, np.zeros(self.n, bool), info

    def foresee(self, steps: int) -> tuple[Any, Any]:
        """The expert makes no progress at step ``STUCK``."""
        ahead = self.step[:, None] + np.arange(steps)
        actions = np.zeros((self.n, steps, 7))
        actions[:, :, 0] = ahead / 100
        actions[ahead >= self.length[:, None]] = np.nan
        return actions, self.step != STUCK

    def observation(self) -> dict[str, Any]:
        picture = (
            np.zeros((self.n, 256, 256, 3), np.uint8)
            + self.step.astype(np.uint8)[:, None, None, None]
        )
        quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (self.n, 1))
        position = np.tile(self.step[:, None] / 10.0, (1, 3))
        return {
            "agentview": picture, "robot0_eye_in_hand": picture, "eef_pos": position,
            "eef_quat": quaternion, "gripper_pos": np.zeros((self.n, 2)),
        }  # fmt: skip

    def close(self) -> None:
        pass


def collect_shards(folder: Path, monkeypatch: pytest.MonkeyPatch, **changed: Any) -> list[Shard]:
    """Runs a collection with these arguments changed, and returns the written shards."""
    monkeypatch.setattr(libero, "VectorEnvironment", FakeEnvironments)
    monkeypatch.setattr(collect, "WORDINGS", 2)
    monkeypatch.setattr(collect, "compile_scenes", lambda *_: None)
    defaults: dict[str, Any] = {
        "into": folder, "seconds": 2.5, "driver": "expert", "weights": None, "perturbed": 0.0,
        "envs": 4, "threads": 1, "tasks": ["libero_goal"], "failures": None, "capsules": None,
        "assets": "primitives", "seed": 0, "device": "cpu",
    }  # fmt: skip
    collect.collect(argparse.Namespace(**(defaults | changed)))
    return [read(path) for path in shard_folders(folder)]


def check_frames(shard: Shard) -> None:
    """Asserts that each frame's pictures, state and targets are of the same step, and that frames
    at which the expert makes no progress are not stored."""
    step = shard.frames[:, 0, 0, 0, 0].astype(int)
    assert set(step) <= {0, 4}
    assert (shard.frames == step[:, None, None, None, None]).all()
    np.testing.assert_allclose(shard.state[:, 0], step / 10, rtol=1e-6)
    ahead = step[:, None] + np.arange(8)
    valid = np.isfinite(shard.target).all(axis=2)
    np.testing.assert_allclose(shard.target[valid][:, 0], ahead[valid] / 100, rtol=1e-6)
    assert set(valid.sum(axis=1) + step) <= {8, *LENGTHS}


def test_frames_targets_and_episodes_agree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shards = collect_shards(tmp_path, monkeypatch)
    assert shards
    for shard in shards:
        check_frames(shard)
        whole = shard.outcome == Outcome.SUCCESS
        assert whole.any() and (shard.episode_frames[whole] == 2).all()
        assert {Driver.CLEAN, Driver.DISTURBED} == set(shard.driver)


def test_a_second_run_adds_shards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = len(collect_shards(tmp_path, monkeypatch, seconds=1.5))
    assert len(collect_shards(tmp_path, monkeypatch, seconds=1.5)) > first


def test_perturbations_differ_from_the_benchmarks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = np.concatenate(
        [shard.perturbation for shard in collect_shards(tmp_path, monkeypatch, perturbed=0.7)]
    )
    assert 0.5 < (names != "").mean() < 0.9
    for name in names[names != ""]:
        axis, radius, config = name.split("/")
        assert axis in (*collect.SINGLE_AXES, "simultaneous")
        assert 0.5 <= float(radius[1:]) <= 8
        assert 10 <= int(config[1:]) <= 999


def test_half_the_episodes_of_a_capsules_task_begin_in_its_states(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = {"suite": "libero_goal", "task_id": 0, "rollout_id": "failed", "max_steps": 300}
    record = {"manifest_row": row, "actions": [[0.0] * 7] * 20, "saved_until": 12}
    file = tmp_path / "failures.capsules"
    file.write_text(json.dumps(record) + "\n")
    changed = {"tasks": ["libero_goal/0"], "capsules": file}
    shards = collect_shards(tmp_path / "data", monkeypatch, **changed)
    names = np.concatenate([shard.perturbation for shard in shards])
    assert set(names) == {"", "failed"} and 0.3 < (names == "failed").mean() < 0.7


def test_four_of_ten_environments_are_of_libero_10() -> None:
    tasks = collect.tasks_of_environments(100, ["libero"], {})
    assert len(tasks) == 100
    assert sum(TASK_NAMES[task].startswith("libero_10") for task in tasks) == 40
    assert set(tasks) == set(range(40))
    # Both groups cover all tasks.
    assert set(tasks[::2]) | set(tasks[1::2]) == set(range(40))


def test_tasks_that_the_student_fails_get_more_environments() -> None:
    outcomes = {name: (10, 10) for name in TASK_NAMES} | {TASK_NAMES[23]: (0, 10)}
    tasks = collect.tasks_of_environments(120, ["libero"], outcomes)
    assert set(tasks) == set(range(40)) and len(tasks) == 120
    assert tasks.count(23) > 2 * tasks.count(22)


def test_tasks_are_chosen_by_prefix() -> None:
    tasks = collect.tasks_of_environments(8, ["libero_goal/3", "libero_10/9"], {})
    assert {TASK_NAMES[task] for task in tasks} == {"libero_goal/3", "libero_10/9"}
    with pytest.raises(SystemExit, match="libero_11"):
        collect.tasks_of_environments(8, ["libero_11"], {})


def test_the_student_needs_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SystemExit, match="--weights"):
        collect_shards(tmp_path, monkeypatch, driver="student")


def test_the_student_takes_part_once_its_weights_exist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import torch

    from training.network import Network
    from training.student import save_weights

    torch.manual_seed(0)
    save_weights(Network().state_dict(), tmp_path / "weights", "student")
    shards = collect_shards(
        tmp_path / "data", monkeypatch, driver="student", weights=tmp_path / "weights", seconds=5.0
    )
    drivers = np.concatenate([shard.driver for shard in shards])
    assert set(drivers) <= {Driver.IN_TURNS, Driver.STUDENT} and len(drivers)
    for shard in shards:
        check_frames(shard)


def test_the_student_keeps_its_weights_when_their_file_disappears(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import torch

    monkeypatch.setattr(collect, "Student", lambda *_: object())
    weights = tmp_path / "weights"
    newest_student = collect.NewestStudent(weights, torch.device("cpu"))
    assert newest_student.student() is None
    weights.touch()
    student = newest_student.student()
    assert student is not None
    weights.unlink()
    assert newest_student.student() is student

    def disappears(*_: object) -> None:
        raise FileNotFoundError

    # The file may also disappear while it is read.
    monkeypatch.setattr(collect, "Student", disappears)
    weights.touch()
    os.utime(weights, ns=(1, 1))
    assert newest_student.student() is student


def test_a_further_run_into_a_folder_adds_to_the_outcomes(tmp_path: Path) -> None:
    first, second = TASK_NAMES[:2]
    collect.add_outcomes(tmp_path, {first: [1, 2]})
    collect.add_outcomes(tmp_path, {first: [3, 4], second: [0, 5]})
    assert collect.read_outcomes([tmp_path]) == {first: [4, 6], second: [0, 5]}


def test_the_trainer_reads_the_folders_of_all_processes(tmp_path: Path) -> None:
    earlier = tmp_path / "round_00_11"
    earlier.mkdir()
    folders = pipeline.folders_to_train_on(tmp_path, 10 * pipeline.THREADS)
    assert earlier in folders
    assert {tmp_path / f"round_01_{at}" for at in range(10)} <= set(folders)
    assert tmp_path / "round_01_10" not in folders
