"""The adapters of lerobot's policies, with lerobot and RANDOM weights.

Skipped where lerobot is not installed (it brings PyTorch):

    pip install -e './policies[dev]' 'lerobot[smolvla,pi,vla-jepa]==0.6.1'
    POLICY_GATEWAY=PROGRAM python -m pytest policies/tests/test_lerobot.py
"""

import contextlib
import shutil

import numpy as np
import pytest
from conftest import assert_conforms
from test_adapters import next_one, observation

pytest.importorskip("lerobot", reason="lerobot is not installed")

import random_lerobot  # noqa: E402
from safetensors.torch import load_file, save_file  # noqa: E402

from rollout_policies.adapters import Options, load  # noqa: E402
from rollout_policies.adapters.upstream import UnusableCheckpoint  # noqa: E402

#: ACT is lerobot's own and stands in MINERVA's place: it, too, keeps chunks of
#: one episode inside the policy.
ADAPTERS = {"smolvla": "smolvla", "pi05": "pi05", "vla-jepa": "vla-jepa", "act": "minerva"}


@pytest.fixture(scope="module", params=list(ADAPTERS))
def checkpoint(request, tmp_path_factory):
    """A policy of random weights and its folder: `(name, folder)`."""
    name = request.param
    folder = tmp_path_factory.mktemp(name)
    random_lerobot.POLICIES[name](folder)
    yield name, folder
    shutil.rmtree(folder)


@pytest.fixture(scope="module")
def policy(checkpoint):
    return loaded(*checkpoint)


def loaded(name, folder, **options):
    sizes = random_lerobot.small_pi05() if name == "pi05" else contextlib.nullcontext()
    with sizes:
        return load(ADAPTERS[name], Options(checkpoint=str(folder), device="cpu", **options))


def play(policy, seed, queries=3):
    """The answers of an episode that starts anew."""
    seen = observation(seed)
    policy.reset(seen.episode)
    return [policy.infer(next_one(seen, index)) for index in range(queries)]


def test_the_description_counts_and_names_what_was_loaded(policy, checkpoint):
    described = policy.description
    assert described.checkpoint == str(checkpoint[1])
    assert len(described.checkpoint_digest) == 64
    assert described.parameters > 100_000
    expected = {"smolvla": (50, 1), "pi05": (10, 10), "vla-jepa": (7, 7), "act": (1, 1)}
    assert (described.horizon, described.execute) == expected[checkpoint[0]]


def test_an_episode_depends_on_its_seed_alone(policy):
    first = play(policy, seed=1)
    assert np.array_equal(first, play(policy, seed=1))
    assert np.isfinite(first).all()
    same = np.array_equal(first, play(policy, seed=2))
    assert same != policy.description.stochastic


def test_episodes_side_by_side_are_those_that_ran_alone(policy):
    alone = [play(policy, seed) for seed in (1, 2)]
    episodes = [observation(1), observation(2)]
    for one in episodes:
        policy.reset(one.episode)
    together = [[policy.infer(next_one(one, index)) for one in episodes] for index in range(3)]
    assert np.array_equal(np.swapaxes(together, 0, 1), alone)


def test_the_instruction_and_the_frames_matter(policy, checkpoint):
    # Random weights hardly look; that they look at all is what counts.
    seen = observation(1)
    dark = observation(1)
    object.__setattr__(dark, "images", {key: np.zeros_like(dark.images[key]) for key in dark.images})
    answers = []
    for one in (seen, dark, observation(1, instruction="pick up the butter")):
        policy.reset(one.episode)
        answers.append(policy.infer(one))
    assert (answers[0] != answers[1]).any()
    reads = checkpoint[0] != "act"
    assert (answers[0] != answers[2]).any() == reads


def test_a_batch_moves_low_order_bits_and_no_more(checkpoint):
    name, folder = checkpoint
    if name not in ("smolvla", "pi05"):
        pytest.skip(f"{name} answers one query at a time")
    policy = loaded(name, folder, max_batch=4)
    queries = [observation(seed, instruction="pick up the butter") for seed in (1, 2, 3)]
    alone = [policy.infer(one) for one in queries]
    assert np.allclose(policy.infer_batch(queries), alone, atol=1e-4)


def test_weights_that_do_not_fit_are_refused(checkpoint, tmp_path):
    name, folder = checkpoint
    broken = tmp_path / "broken"
    shutil.copytree(folder, broken)
    weights = broken / "model.safetensors"
    save_file({"elsewhere." + key: value for key, value in load_file(weights).items()}, weights)
    with pytest.raises((UnusableCheckpoint, RuntimeError)):
        loaded(name, broken)


def test_a_checkpoint_of_another_policy_is_refused(checkpoint):
    name, folder = checkpoint
    other = "vla-jepa" if name == "smolvla" else "smolvla"
    with pytest.raises(UnusableCheckpoint, match="not (SmolVLA|VLA-JEPA); name another"):
        load(other, Options(checkpoint=str(folder), device="cpu"))


def test_a_server_of_it_conforms(policy):
    assert_conforms(policy)
