"""Shards on disk, and the targets computed from them."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="PyTorch is not installed")

from training.shards import (
    Driver,
    Episode,
    Outcome,
    Source,
    Writer,
    next_number,
    read,
    shard_folders,
    targets,
    worth_learning,
    write,
)


def episode(steps: int, *, first_label: float = 0.0, driver: Driver = Driver.CLEAN,
            outcome: Outcome = Outcome.SUCCESS) -> Episode:  # fmt: skip
    """Returns a fake episode with a frame at every third step. The first number of a label is the
    step plus ``first_label``."""
    frame_step = np.arange(0, steps, 3, dtype=np.int32)
    label = np.zeros((steps, 7), np.float32)
    label[:, 0] = first_label + np.arange(steps)
    return Episode(
        task=2,
        outcome=outcome,
        driver=driver,
        perturbation="",
        frames=np.zeros((len(frame_step), 2, 128, 128, 3), np.uint8),
        state=np.zeros((len(frame_step), 14), np.float32),
        frame_step=frame_step,
        label=label,
        executed=label.copy(),
        source=np.zeros(steps, np.uint8),
    )


def test_targets_are_the_next_labels_up_to_the_episodes_end(tmp_path: Path) -> None:
    shard = read(write(tmp_path, 0, [episode(10), episode(5, first_label=100)]))
    actions, valid = targets(shard)
    assert actions.shape == (4 + 2, 8, 7)
    assert actions[1, :, 0].tolist() == [3, 4, 5, 6, 7, 8, 9, 9]
    assert valid.sum(axis=1).tolist() == [8, 7, 4, 1, 5, 2]
    assert actions[4, :5, 0].tolist() == [100, 101, 102, 103, 104]


def test_targets_after_a_push_do_not_count(tmp_path: Path) -> None:
    pushed = episode(20)
    pushed.source[5:7] = Source.PUSH
    _, valid = targets(read(write(tmp_path, 0, [pushed])))
    # Frames are at steps 0, 3, 6 and so on; steps 5 and 6 are pushed. The targets of a frame count
    # up to and including the first pushed step.
    assert valid.sum(axis=1).tolist()[:4] == [6, 3, 1, 8]
    assert valid[0].tolist() == [True] * 6 + [False] * 2


def test_targets_continue_after_noise_and_end_when_the_student_drifts(tmp_path: Path) -> None:
    noisy, drifting, gripping, agreeing = (episode(9) for _ in range(4))
    noisy.executed[:, 1] += 0.4
    noisy.source[:] = Source.NOISE
    for by_student in (drifting, gripping, agreeing):
        by_student.source[:] = Source.STUDENT
    drifting.executed[:, 1] += 0.2
    gripping.executed[2, 6] += 2.0
    agreeing.executed[:, 1] += 0.01
    _, valid = targets(read(write(tmp_path, 0, [noisy, drifting, gripping, agreeing])))
    assert valid[::3].sum(axis=1).tolist() == [8, 3, 3, 8]


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
        writer.add(episode(10))
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
