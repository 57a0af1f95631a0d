"""The adapters of lerobot's policies, with lerobot and RANDOM weights.

Skipped where lerobot is not installed (it brings PyTorch):

    pip install -e './policies[dev]' 'lerobot[smolvla,pi,vla-jepa]==0.6.1'
    POLICY_GATEWAY=PROGRAM python -m pytest policies/tests/test_lerobot.py"""

import contextlib
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from conftest import assert_conforms
from test_adapters import later_query, observation

pytest.importorskip("lerobot", reason="lerobot is not installed")

import random_lerobot  # noqa: E402
from safetensors.torch import load_file, save_file  # noqa: E402

from rollout_policies import UnderWay  # noqa: E402
from rollout_policies.adapters import Options, load  # noqa: E402
from rollout_policies.adapters.upstream import UnusableCheckpoint, UnusableOption  # noqa: E402

#: The adapter of each random policy. ACT stands in for MINERVA: like it, it holds the action queue of
#: a single episode, which the adapter exchanges at each query.
ADAPTERS = {"smolvla": "smolvla", "pi05": "pi05", "vla-jepa": "vla-jepa", "act": "minerva"}


@pytest.fixture(scope="module", params=list(ADAPTERS))
def checkpoint(request, tmp_path_factory):
    """A policy with random weights and its folder: `(name, folder)`."""
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
    """Starts an episode. Returns the answers to its first queries."""
    first_query = observation(seed)
    policy.reset(first_query.episode)
    return [policy.infer(later_query(first_query, index)) for index in range(queries)]


def test_the_description_has_parameters_and_checkpoint(policy, checkpoint):
    described = policy.description
    assert described.checkpoint == str(checkpoint[1])
    assert len(described.checkpoint_digest) == 64
    assert described.parameters > 100_000
    # Each checkpoint's own horizon and executed actions, since none is in the catalogue.
    expected = {"smolvla": (50, 50), "pi05": (10, 10), "vla-jepa": (7, 7), "act": (1, 1)}
    assert (described.horizon, described.execute) == expected[checkpoint[0]]


def test_the_settings_hold_the_resolved_configuration(policy, checkpoint):
    settings = dict(policy.description.settings)
    name = checkpoint[0]
    slots = {
        "smolvla": "camera1=agentview, camera2=robot0_eye_in_hand, camera3=nothing",
        "pi05": "empty_camera_0=nothing, image=agentview, image2=robot0_eye_in_hand",
    }
    assert settings["image slots"] == slots.get(name, "image=agentview, image2=robot0_eye_in_hand")
    assert settings["state slots"] == "observation.state=eef_pos, eef_axis_angle, gripper_pos"
    mode = {"pi05": "QUANTILES", "vla-jepa": "MIN_MAX"}.get(name, "MEAN_STD")
    assert settings["statistics"].startswith(f"actions {mode} ")
    assert "the state " in settings["statistics"]
    assert settings["device"] == "cpu"
    assert settings["precision"]
    assert settings["lerobot"]


def test_execute_sets_the_number_of_executed_actions(checkpoint):
    name, folder = checkpoint
    if name == "act":
        with pytest.raises(UnusableOption, match="--execute is 2, and MINERVA answers 1 action"):
            loaded(name, folder, execute=2)
        return
    assert loaded(name, folder, execute=2).description.execute == 2
    with pytest.raises(UnusableOption, match="--execute is 99, and .* answers chunks of"):
        loaded(name, folder, execute=99)


def test_an_episode_depends_on_its_seed_alone(policy):
    first = play(policy, seed=1)
    assert np.array_equal(first, play(policy, seed=1))
    assert np.isfinite(first).all()
    same = np.array_equal(first, play(policy, seed=2))
    assert same != policy.description.stochastic


def test_interleaved_episodes_equal_single_ones(policy):
    alone = [play(policy, seed) for seed in (1, 2)]
    episodes = [observation(1), observation(2)]
    for first_query in episodes:
        policy.reset(first_query.episode)
    together = [
        [policy.infer(later_query(first_query, index)) for first_query in episodes]
        for index in range(3)
    ]
    assert np.array_equal(np.swapaxes(together, 0, 1), alone)


def test_actions_depend_on_instruction_and_frames(policy, checkpoint):
    # Random weights depend little on the input; the test needs only some dependence.
    first_query = observation(1)
    black = {key: np.zeros_like(frame) for key, frame in first_query.images.items()}
    dark = replace(first_query, images=black)
    answers = []
    for query in (first_query, dark, observation(1, instruction="pick up the butter")):
        policy.reset(query.episode)
        answers.append(policy.infer(query))
    assert (answers[0] != answers[1]).any()
    uses_instruction = checkpoint[0] != "act"
    assert (answers[0] != answers[2]).any() == uses_instruction


def test_a_chunk_continues_the_actions_under_way(policy, checkpoint):
    name, _ = checkpoint
    assert policy.description.real_time_chunking == (name in ("smolvla", "pi05"))
    if not policy.description.real_time_chunking:
        return
    first_query = observation(1)
    policy.reset(first_query.episode)
    unguided = policy.infer(first_query)
    # Actions of another episode, of which two have been executed; any would do.
    under_way = policy.infer(observation(2))[2:].astype(np.float32)
    delay = 4
    continued = policy.infer(replace(first_query, under_way=UnderWay(under_way, delay)))
    assert continued.shape == unguided.shape and np.isfinite(continued).all()

    def distance(chunk, steps):
        return np.abs(chunk[steps] - under_way[steps]).mean()

    # lerobot's guidance fades from the delay on, and ends after ten actions.
    during_delay, after_delay = slice(0, delay), slice(delay, 8)
    assert distance(continued, during_delay) < distance(unguided, during_delay) / 2
    assert np.array_equal(policy.infer(first_query), unguided), (
        "without actions under way, nothing changes"
    )
    # The actions under way guide the new chunk only up to their end.
    short = policy.infer(replace(first_query, under_way=UnderWay(executed[:delay], delay)))
    assert distance(continued, after_delay) < distance(short, after_delay)


def test_a_batch_changes_low_order_bits_only(checkpoint):
    name, folder = checkpoint
    if name not in ("smolvla", "pi05"):
        pytest.skip(f"{name} answers one query at a time")
    policy = loaded(name, folder, max_batch=4)
    queries = [observation(seed, instruction="pick up the butter") for seed in (1, 2, 3)]
    alone = [policy.infer(query) for query in queries]
    assert np.allclose(policy.infer_batch(queries), alone, atol=1e-4)


@pytest.fixture
def altered(checkpoint, tmp_path):
    """A copy of the checkpoint, for planting faults: `(name, folder)`."""
    name, folder = checkpoint
    shutil.copytree(folder, tmp_path / "altered")
    return name, tmp_path / "altered"


@contextlib.contextmanager
def stored_tensors(folder):
    """Yields the tensors of a checkpoint, and stores them again afterwards."""
    weights = folder / "model.safetensors"
    tensors = load_file(weights)
    yield tensors
    save_file(tensors, weights)


@contextlib.contextmanager
def json_content(folder, file):
    """Yields a JSON file's content, and writes it again afterwards."""
    path = folder / file
    content = json.loads(path.read_text("utf-8"))
    yield content
    path.write_text(json.dumps(content), "utf-8")


#: A tensor that each policy's actions depend on, where lerobot still calls it so.
ACTING_TENSOR = {
    "smolvla": "model.action_out_proj.weight",
    "pi05": "model.action_out_proj.weight",
    "vla-jepa": "model.action_model.action_encoder.layer1.weight",
    "act": "model.action_head.weight",
}


def test_a_file_that_lacks_one_tensor_is_refused(altered):
    name, folder = altered
    with stored_tensors(folder) as tensors:
        tensors.pop(acting_tensor := acting_tensor_of(name, tensors))
    with pytest.raises(UnusableCheckpoint, match=rf"1 missing in the file \({acting_tensor}\)"):
        loaded(name, folder)


def test_a_large_tensor_that_differs_from_the_file_is_refused(altered, monkeypatch):
    # Simulates a loader that fails half way: one number of the largest tensor differs.
    name, folder = altered
    from rollout_policies.adapters import lerobot as adapter

    inner = adapter._require_weights
    largest = []

    def require_weights_after_a_change(network, file, checkpoint):
        tensors = network.state_dict()
        largest.append(max(tensors, key=lambda key: tensors[key].numel()))
        tensors[largest[0]].flatten()[-1] += 1
        inner(network, file, checkpoint)

    monkeypatch.setattr(adapter, "_require_weights", require_weights_after_a_change)
    with pytest.raises(UnusableCheckpoint, match="1 with other content") as refused:
        loaded(name, folder)
    assert largest[0] in str(refused.value)


def test_embeddings_that_are_tied_in_the_file_are_loaded_or_refused(altered):
    # If a file of π0.5 lacks the embedding, as the released file does, lerobot copies the head's
    # weights into it. For SmolVLA lerobot copies nothing, and such a file is refused.
    name, folder = altered
    if name not in ("smolvla", "pi05"):
        pytest.skip(f"{name} has no tied embeddings")
    with stored_tensors(folder) as tensors:
        [embedding] = [key for key in tensors if key.endswith("embed_tokens.weight")]
        del tensors[embedding]
    if name == "pi05":
        assert play(loaded(name, folder), seed=1, queries=1)
    else:
        with pytest.raises(UnusableCheckpoint, match="missing in the file .*embed_tokens"):
            loaded(name, folder)


def acting_tensor_of(name, tensors):
    """Returns the name in ACTING_TENSOR, or else the last weight's name that contains `action`."""
    if ACTING_TENSOR[name] in tensors:
        return ACTING_TENSOR[name]
    return sorted(key for key in tensors if "action" in key and key.endswith("weight"))[-1]


def rename_slots(folder, names):
    """Renames the image slots of a checkpoint."""
    for file in ("config.json", "policy_preprocessor.json", "policy_postprocessor.json"):
        text = (folder / file).read_text("utf-8")
        for old, new in names.items():
            text = text.replace(f'"observation.images.{old}"', f'"observation.images.{new}"')
        (folder / file).write_text(text, "utf-8")


def test_the_order_of_camera_names_does_not_matter(policy, altered):
    name, folder = altered
    first, second = ("camera1", "camera2") if name == "smolvla" else ("image", "image2")
    rename_slots(folder, {first: "front", second: "cam_wrist"})
    renamed = loaded(name, folder)
    assert "cam_wrist=robot0_eye_in_hand" in renamed.description.settings["image slots"]
    assert np.array_equal(play(renamed, seed=1), play(policy, seed=1))
    # Swapped cameras change the actions.
    swapped = loaded(name, folder, image_keys={"scene": "cam_wrist", "wrist": "front"})
    assert not np.array_equal(play(swapped, seed=1), play(policy, seed=1))


def test_slots_with_unknown_names_are_refused_with_the_flag_to_add(altered):
    name, folder = altered
    first, second = ("camera1", "camera2") if name == "smolvla" else ("image", "image2")
    rename_slots(folder, {first: "left", second: "right"})
    with pytest.raises(UnusableCheckpoint, match="--image-keys scene=left,wrist=right"):
        loaded(name, folder)
    assert loaded(name, folder, image_keys={"scene": "left", "wrist": "right"})


@pytest.mark.parametrize("feature", ["action", "observation.state"])
def test_a_checkpoint_without_statistics_is_refused(altered, feature):
    # lerobot would leave the numbers unchanged.
    name, folder = altered
    for file in folder.glob("policy_*normalizer_processor.safetensors"):
        drop_statistics(file, feature)
    title = "actions" if feature == "action" else "the state"
    with pytest.raises(UnusableCheckpoint, match=f"has no statistics of {title}"):
        loaded(name, folder)


def drop_statistics(file, feature):
    tensors = load_file(file)
    kept = {key: tensors[key] for key in tensors if not key.startswith(f"{feature}.")}
    save_file(kept, file)


def test_a_missing_file_is_named_with_the_remedy(altered):
    name, folder = altered
    (folder / "policy_preprocessor.json").unlink()
    with pytest.raises(UnusableCheckpoint, match="no policy_preprocessor.json.*convert it"):
        loaded(name, folder)
    (folder / "model.safetensors").unlink()
    (folder / "adapter_config.json").write_text("{}")
    with pytest.raises(UnusableCheckpoint, match="no model.safetensors.*a LoRA.*merge"):
        loaded(name, folder)


def test_the_error_for_a_failed_download_lists_all_downloads(altered, monkeypatch):
    name, folder = altered
    field = {"smolvla": "vlm_model_name", "vla-jepa": "qwen_model_name"}.get(name)
    if field is None:
        pytest.skip(f"{name}'s configuration names no repository")
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    with json_content(folder, "config.json") as config:
        config[field] = "nobody/nothing"
    with pytest.raises(UnusableCheckpoint, match="downloaded: nobody/nothing .*HF_HUB_OFFLINE"):
        loaded(name, folder)


def test_a_checkpoint_of_another_policy_is_refused(checkpoint):
    name, folder = checkpoint
    other = "vla-jepa" if name == "smolvla" else "smolvla"
    with pytest.raises(UnusableCheckpoint, match="not (SmolVLA|VLA-JEPA); name another"):
        load(other, Options(checkpoint=str(folder), device="cpu"))


def test_a_server_of_each_adapter_conforms(policy):
    assert_conforms(policy)
