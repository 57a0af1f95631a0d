"""Samples, their augmentation, and resumption of an interrupted run."""

import argparse
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from training import augment
from training.augment import PictureChange, Wordings, apply_changes
from training.observations import instruction_rows, scaled
from training.shards import Driver, Episode, Outcome, write
from training.store import Library
from training.student import load_network
from training.text import BUCKETS
from training.train import CHECKPOINT, WEIGHTS, train
from training.wordings import TASK_NAMES, canonical

CPU = torch.device("cpu")


def fill(folder: Path, shards: int, *, first: int = 0) -> None:
    """Writes the shards ``first`` to ``shards`` - 1, each of three small episodes; a frame's bytes
    identify its episode."""
    rng = np.random.default_rng(0)
    for number in range(first, shards):
        episodes = []
        for index in range(3):
            target = rng.uniform(-1, 1, (4, 8, 7)).astype(np.float32)
            frames = np.full((4, 2, 128, 128, 3), 10 * number + index, np.uint8)
            state = rng.normal(size=(4, 14)).astype(np.float32)
            episodes.append(Episode(0, Outcome.SUCCESS, Driver.CLEAN, "", frames, state, target))
        write(folder, number, episodes)


def arguments(folder: Path, **changed: object) -> argparse.Namespace:
    defaults: dict[str, object] = {
        "data": [folder / "data"], "run": folder / "run", "seconds": 0.5, "watch": False,
        "stop_after": None,
        "start_from": None, "name": "student", "batch": 2, "learning_rate": 1e-3,
        "weight_decay": 1e-3, "wordings": 3, "capacity": 200,
        "processes": 1, "compile": False, "seed": 0, "device": "cpu",
    }  # fmt: skip
    return argparse.Namespace(**(defaults | changed))


def test_a_library_separates_held_out_episodes_and_loads_new_shards(tmp_path: Path) -> None:
    fill(tmp_path, 2)
    library = Library([tmp_path], 100, 100, CPU)
    # The first episode of shard 0 is held out. Of shard 1, the eighth episode would be held out,
    # but the shard has only three.
    assert library.refresh() == 24
    assert library.held_out.count == 4 and library.training.count == 20
    assert library.refresh() == 0
    fill(tmp_path, 3, first=2)
    assert library.refresh() == 12
    batch = library.training.batch(torch.arange(library.training.count))
    assert sorted(batch.pictures[:, 0, 0, 0, 0].unique().tolist()) == [1, 2, 10, 11, 12, 20, 21, 22]
    assert library.by_suite.tolist() == [32, 0, 0, 0]


def test_new_frames_replace_stored_frames_when_the_store_is_full(tmp_path: Path) -> None:
    fill(tmp_path, 2)
    library = Library([tmp_path], 14, 100, CPU)
    torch.manual_seed(0)
    library.refresh()
    assert library.training.count == 14
    values = library.training.batch(torch.arange(14)).pictures[:, 0, 0, 0, 0].unique().tolist()
    assert min(values) < 10 <= max(values)


def test_a_shift_repeats_the_edge() -> None:
    picture = torch.arange(128, dtype=torch.uint8).expand(1, 2, 3, 128, 128).permute(0, 1, 3, 4, 2)
    shift = torch.tensor([[[0, 3], [-2, -4]]])
    shift_only = PictureChange(shift, torch.ones(1, 2, 1, 1, 3), torch.zeros(1, 2, 1, 1, 1),
                               torch.zeros(1, 2, 1, 1, 1))  # fmt: skip
    left, right = apply_changes(picture.contiguous(), shift_only)
    columns = (left[0, 0, 5] + 1) * 127.5
    assert columns.round().tolist() == [*range(3, 128), 127, 127, 127]
    assert ((right[0, 2, 9] + 1) * 127.5).round().tolist() == [0] * 4 + [*range(124)]


def test_unchanged_pictures_equal_the_input_at_inference() -> None:
    pictures = torch.randint(0, 256, (2, 2, 128, 128, 3), dtype=torch.uint8)
    no_change = PictureChange(torch.zeros(2, 2, 2, dtype=torch.int64), torch.ones(2, 2, 1, 1, 3),
                              torch.zeros(2, 2, 1, 1, 1), torch.zeros(2, 2, 1, 1, 1))  # fmt: skip
    for camera, view in enumerate(apply_changes(pictures, no_change)):
        torch.testing.assert_close(view, scaled(pictures[:, camera]))


def test_instructions_in_training_have_the_features_of_their_words() -> None:
    wordings = Wordings(3, 0, CPU)
    rows, present = wordings.canonical(torch.tensor([0, 27]))
    for index, task in enumerate((0, 27)):
        expected, expected_present = instruction_rows([canonical(TASK_NAMES[task])])
        counts = np.bincount(rows[index][present[index] > 0], minlength=BUCKETS)
        expected_counts = np.bincount(expected[0][expected_present[0] > 0], minlength=BUCKETS)
        assert np.array_equal(counts, expected_counts)


def test_dropping_a_word_drops_its_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(augment, "CANONICAL_SHARE", 0.0)
    monkeypatch.setattr(augment, "MAX_PAIRS_DROPPED", 0.0)
    torch.manual_seed(1)
    _, present = Wordings(3, 0, CPU).draw(torch.zeros(64, dtype=torch.int64))
    words = (present.shape[1] + 1) // 2
    kept, pairs = present[:, :words], present[:, words:]
    assert torch.equal(pairs, kept[:, 1:] * kept[:, :-1])
    assert (kept.sum(dim=1).unique().numel()) > 3


def test_a_run_resumes_from_checkpoint(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fill(tmp_path / "data", 2)
    train(arguments(tmp_path))
    state = torch.load(tmp_path / "run" / CHECKPOINT, weights_only=True)
    assert state["finished"] and state["step"] > 0
    with pytest.raises(SystemExit, match="has finished"):
        train(arguments(tmp_path))

    torch.save(state | {"finished": False}, tmp_path / "run" / CHECKPOINT)
    train(arguments(tmp_path, seconds=state["trained_seconds"] + 2.0))
    assert f"resumes at step {state['step']}" in capsys.readouterr().out
    later = torch.load(tmp_path / "run" / CHECKPOINT, weights_only=True)
    assert later["step"] > state["step"] and later["trained_seconds"] > state["trained_seconds"]

    weights = tmp_path / "run" / WEIGHTS
    train(arguments(tmp_path, run=tmp_path / "second", start_from=weights))
    assert f"starts from {weights}" in capsys.readouterr().out


def test_weights_are_half_precision_except_the_states_scale(tmp_path: Path) -> None:
    from safetensors import safe_open

    fill(tmp_path / "data", 1)
    train(arguments(tmp_path))
    file = tmp_path / "run" / WEIGHTS
    with safe_open(file, "pt") as opened:
        assert opened.metadata() == {"format": "rollout-student/2", "name": "student"}
        types = {name: opened.get_tensor(name).dtype for name in opened.keys()}
    single = {name for name, dtype in types.items() if dtype != torch.float16}
    assert single == {"state_mean", "state_std"}
    assert file.stat().st_size < 4_000_000
    assert load_network(file, CPU).state_std.min() >= 0.009


def test_exported_weights_name_the_look_that_was_learned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rollout_libero", reason="rollout_libero is not installed")
    from safetensors import safe_open

    from training.export import export

    fill(tmp_path / "data", 1)
    train(arguments(tmp_path))
    monkeypatch.setenv("ROLLOUT_LOOK", "mujoco-3.3.3")
    export(tmp_path / "run", "student", tmp_path / "weights")
    with safe_open(tmp_path / "weights", "pt") as opened:
        assert opened.metadata()["look"] == "mujoco-3.3.3"


def test_training_without_shards_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="run training.collect first"):
        train(arguments(tmp_path))
