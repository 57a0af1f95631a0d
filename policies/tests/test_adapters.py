"""The adapters up to the call of the upstream network, whose arguments are recorded.

The recording stand-ins answer as a test specifies. Everything around them, from the observation to
the arguments and from the answer to the actions, is production code."""

import os
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_conformance import adapters_with_computed_networks
from test_processing import pattern

from rollout_policies import Camera, Episode, Observation, State, UnderWay
from rollout_policies.adapters import (
    MODULES,
    Options,
    executed_actions,
    openvla_oft,
    predvla,
    univla,
)
from rollout_policies.adapters.cameras import camera_of_slot
from rollout_policies.adapters.flow import FlowPolicy
from rollout_policies.adapters.lerobot import batch_of
from rollout_policies.adapters.minerva import Minerva
from rollout_policies.adapters.upstream import (
    UnusableCheckpoint,
    UnusableOption,
    WrongSuite,
    digest,
)
from rollout_policies.adapters.vla_jepa import VlaJepa
from rollout_policies.catalogue import SUITES, NoCheckpoint, entries, entry
from rollout_policies.description import Language

#: Half a turn about x: the orientation of a hand that points down.
POINTING_DOWN = [1.0, 0.0, 0.0, 0.0]
LOADED = {"suite": "libero_goal", "checkpoint": "weights"}
BOUNDS = {"q01": [-2.0] * 7, "q99": [2.0] * 7, "mask": [True] * 6 + [False]}


def observation(seed=7, query_index=0, suite="libero_goal", instruction="Open the Drawer"):
    episode = Episode("s", suite, instruction, seed)
    return Observation(
        episode,
        query_index,
        {"agentview": pattern(256), "robot0_eye_in_hand": pattern(256)[::-1]},
        {
            State.EEF_POS: np.array([0.1, 0.2, 0.3]),
            State.EEF_QUAT_XYZW: np.array(POINTING_DOWN),
            State.GRIPPER_POS: np.array([0.04, -0.04]),
            State.JOINT_POS: np.arange(7.0),
        },
    )


def later_query(earlier, query_index):
    return Observation(earlier.episode, query_index, earlier.images, earlier.state)


# Policies that lerobot runs.


def test_lerobot_gets_turned_frames_and_a_state_of_eight_numbers():
    slots = camera_of_slot(["observation.images.image", "observation.images.image2"])
    assert slots["observation.images.image"] == "agentview"
    batch = batch_of([observation(), observation(instruction="other")], slots)
    frames = batch["observation.images.image"]
    assert frames.shape == (2, 3, 256, 256) and frames.dtype == np.float32
    # The last pixel of the last row is first after the turn.
    assert (frames[0, :, 0, 0] == pattern(256)[255, 255] / np.float32(255)).all()
    assert (frames[0, :, 0, 1] == pattern(256)[255, 254] / np.float32(255)).all()
    assert batch["observation.state"].dtype == np.float32
    expected = [0.1, 0.2, 0.3, np.pi, 0, 0, 0.04, -0.04]
    assert batch["observation.state"][1] == pytest.approx(expected)
    assert batch["task"] == ["Open the Drawer", "other"]
    assert "observation.state" not in batch_of([observation()], slots, with_state=False)


class Loaded:
    """Properties that a loaded model reports."""

    checkpoint, checkpoint_digest, parameters = "weights", "d1", 3
    cameras = (Camera("agentview"), Camera("robot0_eye_in_hand"))
    fields = (State.EEF_POS, State.EEF_QUAT_XYZW, State.GRIPPER_POS)
    settings = {"image slots": "image=agentview, image2=robot0_eye_in_hand"}


class RecordingFlow(Loaded):
    """Records its calls. Answers the given noise, else noise of a generator with its last seed."""

    config = SimpleNamespace(chunk_size=50, max_action_dim=32)
    chunks_in_real_time = True

    def __init__(self):
        self.seeds = []
        self.calls = []

    def seed(self, seed):
        self.seeds.append(seed)

    def chunks(self, observations, noise=None, under_way=None):
        self.calls.append((len(observations), under_way))
        if noise is None:
            generator = np.random.default_rng(self.seeds[-1])
            noise = generator.standard_normal((len(observations), 50, 7))
        return noise[..., :7]


def flow(cls=FlowPolicy, name="smolvla", **fields):
    return cls(entry(name), RecordingFlow(), execute=1, **fields)


def test_a_flow_policy_describes_its_chunk_and_executed_actions():
    described = flow(max_batch=8).description
    assert (described.horizon, described.execute, described.max_batch) == (50, 1, 8)
    assert described.stochastic and not described.stateful
    assert [camera.name for camera in described.cameras] == ["agentview", "robot0_eye_in_hand"]
    sent = {setting.name: setting.value for setting in described.to_message().settings}
    assert sent == Loaded.settings


def test_a_flow_policy_passes_on_the_actions_under_way_per_query():
    under_way = UnderWay(np.ones((9, 7), np.float32), 4)
    queries = [observation(seed) for seed in (1, 2, 3)]
    queries[1] = replace(queries[1], under_way=under_way)
    policy = flow(max_batch=4)
    assert policy.description.real_time_chunking
    alone = [policy.infer(query) for query in queries]
    policy.model.calls.clear()
    assert np.array_equal(policy.infer_batch(queries), alone)
    assert policy.model.calls == [(1, under_way), (2, None)]


def test_listed_checkpoints_execute_the_protocols_number_and_others_their_own():
    smolvla = entry("smolvla")
    numbers = {"chunk": 50, "from_checkpoint": 10}
    assert executed_actions(smolvla, Options(), **numbers) == 1
    assert executed_actions(smolvla, Options(checkpoint="lerobot/smolvla_libero"), **numbers) == 1
    assert executed_actions(smolvla, Options(checkpoint="me/mine"), **numbers) == 10
    assert executed_actions(smolvla, Options(execute=5), **numbers) == 5
    assert executed_actions(smolvla, Options(checkpoint="me/mine", execute=5), **numbers) == 5
    # This chunk is shorter than the number of actions that LIBERO-CTRL executes with the listed
    # checkpoint.
    pi05 = entry("pi05")
    assert executed_actions(pi05, Options(checkpoint="me/mine"), chunk=5, from_checkpoint=5) == 5


def test_an_executed_number_other_than_the_protocols_is_logged(caplog):
    executed_actions(entry("smolvla"), Options(checkpoint="me/mine"), chunk=50, from_checkpoint=10)
    assert "executing 10 actions of every chunk" in caplog.text
    assert "LIBERO-CTRL executes 1 with" in caplog.text


@pytest.mark.parametrize(
    ("chunk", "options", "words"),
    [
        (50, Options(execute=51), "--execute is 51, and SmolVLA answers chunks of 50 actions"),
        (1, Options(execute=2), "--execute is 2, and SmolVLA answers 1 action here; it must be 1"),
    ],
)
def test_more_actions_than_a_chunk_has_are_refused(chunk, options, words):
    with pytest.raises(UnusableOption, match=words):
        executed_actions(entry("smolvla"), options, chunk=chunk, from_checkpoint=1)


@pytest.mark.parametrize(("cls", "name"), [(FlowPolicy, "smolvla"), (VlaJepa, "vla-jepa")])
def test_noise_depends_on_seed_and_query_only(cls, name):
    policy = flow(cls, name)
    query, other_query = observation(seed=1, query_index=3), observation(seed=2, query_index=3)
    alone = policy.infer(query)
    assert (policy.infer(query) == alone).all()
    assert (policy.infer_batch([other_query, query])[1] == alone).all()
    assert (policy.infer(other_query) != alone).any()
    assert (policy.infer(later_query(query, 4)) != alone).any()
    assert alone.shape == (50, 7)


class RecordingLerobot(Loaded):
    """Counts the queries of each episode in its memory, which replaces lerobot's queues."""

    def fresh_memory(self):
        return {"count": 0}

    def act(self, observation, memory):
        memory["count"] += 1
        return np.full(7, memory["count"] / 10)


def test_minerva_declares_canonical_instructions_and_keeps_episodes_apart():
    policy = Minerva(entry("minerva"), RecordingLerobot())
    assert policy.description.language is Language.CANONICAL_ONLY
    assert policy.description.stateful and policy.description.horizon == 1
    first, second = observation(), observation()
    policy.reset(first.episode)
    policy.reset(second.episode)
    answers = [policy.infer(query)[0] for query in (first, first, second, first)]
    assert answers == pytest.approx([0.1, 0.2, 0.1, 0.3])


# OpenVLA-OFT and UniVLA.


class RecordingOft:
    parameters = 3
    proprio_statistics = {"q01": [0.0] * 8, "q99": [1.0] * 8}

    def chunk(self, *arguments):
        self.arguments = arguments
        return np.full((8, 7), 0.9)


def test_openvla_oft_gets_cropped_frames_a_prompt_and_a_scaled_state():
    model = RecordingOft()
    policy = openvla_oft.OpenVlaOft(entry("openvla-oft"), model, **LOADED)
    first_query = observation()
    policy.reset(first_query.episode)
    actions = policy.infer(first_query)
    scene, wrist, text, state = model.arguments
    assert scene.shape == (224, 224, 3) and scene.dtype == np.uint8
    assert (scene == openvla_oft.frame(pattern(256)[::-1, ::-1])).all()
    assert (wrist == openvla_oft.frame(pattern(256)[:, ::-1])).all()
    assert text == "In: What action should the robot take to open the drawer?\nOut:"
    # pi and -0.04 are outside the percentiles.
    assert state == pytest.approx([-0.8, -0.6, -0.4, 1, -1, -1, -0.92, -1], abs=1e-6)
    assert actions.shape == (8, 7)
    assert (actions[:, 6] == -1).all() and (actions[:, :6] == 0.9).all()
    assert (policy.description.horizon, policy.description.execute) == (8, 8)
    shorter = openvla_oft.OpenVlaOft(entry("openvla-oft"), model, **LOADED, execute=4)
    assert (shorter.description.horizon, shorter.description.execute) == (8, 4)


class RecordingUnivla:
    parameters = 3

    def __init__(self):
        self.queries = []

    def chunk(self, pixels, text, generator):
        self.queries.append((text, generator))
        self.pixels = pixels
        # The n-th chunk holds n / 10 everywhere except the gripper, which is open.
        chunk = np.full((12, 7), len(self.queries) / 10)
        chunk[:, 6] = 1
        return chunk, [32001, 2, 32032, 32005], ("after", generator)


def test_univla_carries_latent_actions_and_chunks_from_query_to_query():
    model = RecordingUnivla()
    policy = univla.UniVla(entry("univla"), model, BOUNDS, **LOADED)
    first_query = observation()
    policy.reset(first_query.episode)
    first = policy.infer(first_query)
    second = policy.infer(later_query(first_query, 1))
    assert first == pytest.approx([0.2] * 6 + [-1])
    weight = np.exp(-0.1)
    assert second[0] == pytest.approx(2 * (0.2 + weight * 0.1) / (1 + weight))
    question = "In: What action should the robot take to open the drawer?"
    assert model.queries[0][0] == f"{question}\nOut:"
    # Token 2, the end of the sentence, is not a latent action.
    assert model.queries[1][0] == f"{question} History action <ACT_0><ACT_31><ACT_4>\nOut:"
    # A new episode starts without history and with its own seed.
    again = observation()
    policy.reset(again.episode)
    policy.infer(again)
    assert model.queries[2] == model.queries[0] != model.queries[1]
    assert policy.description.stateful and policy.description.stochastic
    assert (model.pixels == openvla_oft.frame(pattern(256)[::-1, ::-1])).all()


def test_univlas_study_protocol_uses_one_seed_and_crops_whole_pixels():
    model = RecordingUnivla()
    policy = univla.UniVla(entry("univla"), model, BOUNDS, **LOADED, evaluation="study")
    for seed in (1, 2):
        first_query = observation(seed)
        policy.reset(first_query.episode)
        policy.infer(first_query)
        policy.infer(later_query(first_query, 1))
    assert [generator for _, generator in model.queries] == [7, ("after", 7)] * 2
    assert (model.pixels == univla.study_frame(pattern(256)[::-1, ::-1])).all()
    assert not policy.description.stochastic
    assert policy.description.settings["evaluation"] == "study"


# PredVLA.


class RecordingPredvla:
    parameters, stride = 3, 4

    def begin(self, instruction):
        return [instruction]

    def step(self, correction, joints, frames):
        correction.append(None if frames is None else [frame.shape for frame in frames])
        self.joints, self.frames = joints, frames or self.frames
        return np.zeros(7)


def test_predvla_gets_unturned_frames_at_every_fourth_step():
    model = RecordingPredvla()
    policy = predvla.PredVla(entry("predvla"), model, **LOADED)
    first_query = observation()
    policy.reset(first_query.episode)
    for query_index in range(6):
        policy.infer(later_query(first_query, query_index))
    small = [(128, 128, 3)] * 2
    expected = ["Open the Drawer", small, None, None, None, small, None]
    assert first_query.episode.memory.correction == expected
    assert (model.frames[0] == predvla.frame(pattern(256))).all()
    assert model.joints.tolist() == [0, 1, 2, 3, 4, 5, 6, 0.04, -0.04]


def test_every_episode_of_predvla_has_its_own_instruction():
    policy = predvla.PredVla(entry("predvla"), RecordingPredvla(), **LOADED)
    first, second = observation(instruction="one"), observation(instruction="two")
    policy.reset(first.episode)
    policy.reset(second.episode)
    policy.infer(first)
    assert first.episode.memory.correction[0] == "one"
    assert second.episode.memory.correction == ["two"]


def test_a_relative_path_of_statistics_is_resolved_in_the_authors_repository(tmp_path):
    assert predvla._statistics_path("../data/cache_l64", tmp_path) == str(
        tmp_path / "data/cache_l64"
    )
    assert predvla._statistics_path("/elsewhere/cache", tmp_path) == "/elsewhere/cache"


# All adapters.


@pytest.mark.parametrize("policy", adapters_with_computed_networks())
def test_an_episode_of_another_suite_is_refused(policy):
    with pytest.raises(WrongSuite, match="libero_object, and the episode is of libero_goal"):
        policy.reset(observation().episode)


def test_weights_of_predvla_are_found_in_its_repository(tmp_path):
    listed = {suite: entry("predvla").checkpoint_for(suite) for suite in SUITES}
    assert listed == {
        "libero_spatial": "checkpoints/predvla_spatial_s1.pt",
        "libero_object": "checkpoints/predvla_object_s1.pt",
        "libero_goal": "checkpoints/predvla_goal_s1.pt",
        "libero_10": "checkpoints/predvla_long_s1.pt",
    }
    # The paths are relative to the authors' repository, not to the working directory.
    file = tmp_path / listed["libero_goal"]
    file.parent.mkdir()
    file.write_bytes(b"weights")
    assert predvla._checkpoint_file(entry("predvla"), listed["libero_goal"], tmp_path) == file
    with pytest.raises(NoCheckpoint, match="predvla_long_s1.pt here nor in .*--checkpoint"):
        predvla._checkpoint_file(entry("predvla"), listed["libero_10"], tmp_path)


def test_weights_of_predvla_that_were_trained_for_another_suite_are_refused():
    with pytest.raises(UnusableCheckpoint, match="trained for libero_10, and --suite says"):
        predvla._require_trained_for("libero_goal", {"data": {"suite": "libero_10"}}, "w.pt")
    predvla._require_trained_for("libero_goal", {"data": {"suite": "libero_90+libero_goal"}}, "w")


def test_every_policy_of_the_catalogue_has_an_adapter():
    assert list(entries()) == list(MODULES)
    for listed in entries().values():
        assert listed.install and listed.parameters > 0
        for suite in SUITES:
            assert listed.checkpoint_for(suite)


def test_a_digest_changes_with_content_and_name(tmp_path):
    (tmp_path / "a").write_bytes(b"weights")
    (tmp_path / "b").write_bytes(b"weights")
    first, second = digest([tmp_path / "a"]), digest([tmp_path / "b"])
    assert len(first) == 64 and first != second
    assert digest([tmp_path / "b", tmp_path / "a"]) == digest([tmp_path / "a", tmp_path / "b"])


def command(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "rollout_policies", *arguments], capture_output=True, text=True
    )


def test_list_prints_every_policy_with_its_installation_and_downloads():
    listed = command("list")
    assert listed.returncode == 0
    assert max(map(len, listed.stdout.splitlines())) <= 80
    text = " ".join(listed.stdout.split())
    for name, one in entries().items():
        assert f"{name} (" in text and " ".join(one.install.split()) in text
        for download, about in one.downloads.items():
            assert f"also downloads: {download} ({about})" in text


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("serve", "gpt"), 2, ["invalid choice", "smolvla"]),
        (("serve", "predvla"), 2, ["--suite must be one of"]),
        (("serve", "smolvla", "--max-batch", "0"), 2, ["0 is below 1"]),
        (("serve", "minerva", "--max-batch", "2"), 2, ["MINERVA", "--max-batch"]),
        (("serve", "smolvla", "--suite", "nonsense"), 2, ["--suite must be one of", "nonsense"]),
        (("serve", "minerva", "--execute", "4"), 2, ["--execute is 4, and MINERVA"]),
        (("serve", "smolvla", "--image-keys", "left=a"), 2, ["scene=SLOT,wrist=SLOT"]),
        (("serve", "univla", "--image-keys", "scene=a"), 2, ["UniVLA's images have no names"]),
        (("serve", "smolvla", "--evaluation", "study"), 2, ["--evaluation is for univla"]),
        (
            ("serve", "univla", "--suite", "libero_goal", "--checkpoint", "./nowhere"),
            2,
            ["there is no folder ./nowhere", "--checkpoint"],
        ),
    ],
)
def test_a_wrong_command_is_refused_with_the_remedy(arguments, code, words):
    refused = command(*arguments)
    assert refused.returncode == code, refused.stderr
    for word in words:
        assert word in refused.stderr


def test_the_error_for_a_missing_upstream_package_has_the_install_command():
    try:
        import huggingface_hub  # noqa: F401
    except ImportError:
        refused = command("serve", "openvla-oft", "--suite", "libero_10")
        assert refused.returncode == 1
        for word in ("failed to import huggingface_hub", "OpenVLA-OFT", "moojink/openvla-oft"):
            assert word in refused.stderr
    else:
        pytest.skip("huggingface_hub is installed here")


def test_a_checkpoint_of_predvla_that_would_run_code_is_refused(tmp_path):
    torch = pytest.importorskip("torch")
    file, ran = tmp_path / "predvla_goal_s1.pt", tmp_path / "ran"

    class MaliciousPickle:
        def __reduce__(self):
            return os.mkdir, (str(ran),)

    plain = {"cfg": {"data": {"vision_stride": 4}}, "model": {"weight": torch.ones(2)}}
    torch.save({**plain, "extra": MaliciousPickle()}, file)
    with pytest.raises(UnusableCheckpoint, match="would run code of its author"):
        predvla._read_checkpoint(torch, file)
    assert not ran.exists()
    torch.save(plain, file)
    assert predvla._read_checkpoint(torch, file)["cfg"] == plain["cfg"]
