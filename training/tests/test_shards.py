"""Shards on disk."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="PyTorch is not installed")

from training.shards import (
    Driver,
    Episode,
    Outcome,
    Writer,
    next_number,
    read,
    shard_folders,
    worth_learning,
    write,
)


def episode(
    frames: int, *, driver: Driver = Driver.CLEAN, outcome: Outcome = Outcome.SUCCESS
) -> Episode:
    """Returns a fake episode, whose targets begin with the frame's number."""
    target = np.zeros((frames, 8, 7), np.float32)
    target[:, 0, 0] = np.arange(frames)
    return Episode(
        task=2,
        outcome=outcome,
        driver=driver,
        perturbation="",
        frames=np.zeros((frames, 2, 128, 128, 3), np.uint8),
        state=np.zeros((frames, 14), np.float32),
        target=target,
    )


def test_a_shard_has_the_targets_of_its_episodes(tmp_path: Path) -> None:
    shard = read(write(tmp_path, 0, [episode(3), episode(2)]))
    assert shard.target[:, 0, 0].tolist() == [0, 1, 2, 0, 1]
    assert shard.repeat_per_frame(np.array([5, 6])).tolist() == [5, 5, 5, 6, 6]


def test_the_experts_failed_episodes_are_left_out(tmp_path: Path) -> None:
    failed = Outcome.FAILURE
    kinds = [
        episode(3), episode(3, outcome=failed), episode(3, outcome=Outcome.UNFINISHED),
        episode(3, outcome=failed, driver=Driver.DISTURBED),
        episode(3, outcome=failed, driver=Driver.STUDENT),
        episode(3, outcome=failed, driver=Driver.IN_TURNS),
    ]  # fmt: skip
    shard = read(write(tmp_path, 0, kinds))
    assert worth_learning(shard).tolist() == [True, False, True, False, True, True]


def test_a_writer_continues_after_existing_shards(tmp_path: Path) -> None:
    (tmp_path / "shard_00003").mkdir()
    (tmp_path / "shard_00007.part").mkdir()
    writer = Writer(tmp_path, frames_per_shard=5)
    for _ in range(3):
        writer.add(episode(4))
    writer.close()
    assert [path.name for path in shard_folders(tmp_path)] == [
        "shard_00003",
        "shard_00004",
        "shard_00005",
    ]
    assert next_number(tmp_path) == 6
    assert len(read(tmp_path / "shard_00004").task) == 2
    assert len(read(tmp_path / "shard_00005").task) == 1


def test_a_writer_raises_errors_of_the_disk(tmp_path: Path) -> None:
    folder = tmp_path / "shards"
    writer = Writer(folder, frames_per_shard=1)
    folder.rmdir()
    folder.write_text("a file in the folder's place")
    writer.add(episode(3))
    with pytest.raises(OSError):
        writer.close()
