"""The server on a real socket: the guarantees for a policy's author."""

import dataclasses
import os
import re
import signal
import subprocess
import sys

import grpc
import numpy as np
import pytest
from conftest import Answering, Client, Noisy, Recording, refusal

from rollout_policies import Description, Gripper, Policy, State, UnusableDescription, start
from rollout_policies.proto import policy_pb2 as pb


def frame(width=3, height=2, camera="agentview"):
    rgb = bytes(range(width * height * 3))
    return pb.Image(camera=camera, width=width, height=height, rgb=rgb)


def readings(eef=(1.0, 2.0, 3.0), gripper=(0.04, -0.04)):
    return [
        pb.StateReading(field=pb.STATE_FIELD_GRIPPER_POS, values=gripper),
        pb.StateReading(field=pb.STATE_FIELD_EEF_POS, values=eef),
    ]


def test_the_description_reaches_the_caller(serving):
    described = serving(Recording()).describe()
    assert (described.protocol_version, described.name) == (1, "recording")
    assert (described.horizon, described.execute) == (1, 1)
    camera = described.cameras[0]
    assert (camera.name, camera.width, camera.height) == ("agentview", 3, 2)
    assert list(described.state) == [pb.STATE_FIELD_EEF_POS, pb.STATE_FIELD_GRIPPER_POS]


def test_resolved_settings_are_sent_and_printed(serving):
    class Resolved(Recording):
        description = dataclasses.replace(
            Recording.description,
            checkpoint="org/weights",
            settings={"image slots": "image=agentview", "revision": "1f2e3d"},
            gripper=Gripper.RLDS,
            taught_on="libero",
        )

    settings = serving(Resolved()).describe().settings
    assert [(setting.name, setting.value) for setting in settings] == [
        ("image slots", "image=agentview"),
        ("revision", "1f2e3d"),
        ("gripper", "0 closed, 1 open"),
        ("taught on", "libero"),
    ]
    assert Resolved.description.lines() == [
        "policy: recording",
        "checkpoint: org/weights",
        "cameras: agentview 3x2",
        "state: eef_pos, gripper_pos",
        "horizon: 1",
        "execute: 1",
        "gripper: 0 closed, 1 open",
        "taught on: libero",
        "image slots: image=agentview",
        "revision: 1f2e3d",
    ]


def test_another_protocol_version_is_refused_naming_both(serving):
    code, text = refusal(serving(Noisy()).describe, version=99)
    assert code == grpc.StatusCode.FAILED_PRECONDITION
    assert "version 99" in text and "version 1;" in text


def test_a_request_for_another_policy_is_refused(serving):
    client = serving(Noisy())
    assert client.describe(policy="noisy").name == "noisy"
    code, text = refusal(client.describe, policy="pi05")
    assert code == grpc.StatusCode.NOT_FOUND
    assert "'pi05'" in text and "noisy" in text


def test_the_instruction_and_the_seed_arrive_verbatim(serving):
    policy = Recording()
    sentence = "kindly relocate the milk; s'il vous plaît"
    serving(policy).reset(instruction=sentence, suite="libero_goal", seed=2**64 - 1)
    assert policy.episode.instruction == sentence
    assert policy.episode.suite == "libero_goal"
    assert policy.episode.seed == 2**64 - 1


def test_an_observations_frames_can_be_turned_and_its_readings_join_into_a_vector(serving):
    policy = Recording()
    client = serving(policy)
    client.reset()
    client.infer(observation=pb.Observation(images=[frame()], state=readings()))
    received = policy.observation
    # Frames arrive bottom row first. They may be written to, and turned ones are copies.
    raw, upright = received.images["agentview"], received.upright("agentview")
    rotated = received.rotated("agentview")
    for image, first in ((raw, raw[0, 0]), (upright, upright[1, 0]), (rotated, rotated[1, 2])):
        assert image.shape == (2, 3, 3) and image.dtype == np.uint8
        assert image.flags.c_contiguous and image.flags.writeable
        assert first.tolist() == [0, 1, 2]
    upright[:] = 0
    assert raw[0, 1].tolist() == [3, 4, 5]
    assert received.state[State.EEF_POS].tolist() == [1.0, 2.0, 3.0]
    assert received.vector().tolist() == [1.0, 2.0, 3.0, 0.04, -0.04]
    assert received.vector(State.GRIPPER_POS).tolist() == [0.04, -0.04]


@pytest.mark.parametrize(
    ("observation", "expected"),
    [
        (pb.Observation(state=readings()), "no frame of camera 'agentview'"),
        (pb.Observation(images=[frame(4, 2)], state=readings()), "4x2"),
        (pb.Observation(images=[frame()]), "no reading EEF_POS"),
        (pb.Observation(images=[frame()], state=readings(eef=[1.0])), "1 numbers, not 3"),
    ],
)
def test_an_observation_without_a_requested_input_is_refused(serving, observation, expected):
    client = serving(Recording())
    client.reset()
    code, text = refusal(client.infer, query_index=4, observation=observation)
    assert code == grpc.StatusCode.INVALID_ARGUMENT
    assert text.startswith("the observation cannot be used: ") and expected in text


def test_a_retry_gets_the_same_actions_without_another_query(serving):
    policy = Noisy()
    client = serving(policy)
    client.reset()
    first = client.infer(query_index=0)
    assert (client.infer(query_index=0) == first).all()
    assert policy.query_count == 1
    assert (client.infer(query_index=1) != first).all()


@pytest.mark.parametrize(
    ("gripper", "expected"),
    [
        (Gripper.MINUS_ONE_OPENS, [-1, 1, -1]),
        (Gripper.ONE_OPENS, [1, -1, 1]),
        (Gripper.RLDS, [1, 0, 1]),
        (Gripper.ZERO_OPENS, [0, 1, 0]),
    ],
)
def test_actions_under_way_reach_the_policy_in_its_gripper_convention(serving, gripper, expected):
    class RealTimeChunking(Policy):
        description = Description(name="rtc", horizon=3, gripper=gripper, real_time_chunking=True)

        def reset(self, episode):
            episode.memory = []

        def infer(self, observation):
            self.under_way = observation.under_way
            return np.zeros((3, 7))

    policy = RealTimeChunking()
    client = serving(policy)
    assert client.describe().real_time_chunking
    client.reset()
    client.infer()
    assert policy.under_way is None
    sent = np.tile(np.arange(7, dtype=np.float32) / 8, (3, 1))
    sent[:, -1] = [-1, 1, -1]
    request = client.request(query_index=1)
    request.under_way.actions.extend(sent.ravel().tolist())
    request.under_way.action_width, request.under_way.delay = 7, 2
    client.stub.Infer(request)
    assert policy.under_way.delay == 2
    assert np.array_equal(policy.under_way.actions[:, :6], sent[:, :6])
    assert policy.under_way.actions[:, 6].tolist() == expected
    request.query_index, request.under_way.action_width = 2, 6
    code, text = refusal(client.stub.Infer, request)
    assert code == grpc.StatusCode.INVALID_ARGUMENT
    assert "6 per action, not 7" in text


def test_noise_depends_on_seed_and_query_alone(serving):
    client = serving(Noisy())
    client.reset("a", seed=3)
    client.reset("b", seed=3)
    client.reset("c", seed=4)
    forward = [client.infer("a", index) for index in (0, 1, 2)]
    backward = [client.infer("b", index) for index in (2, 1, 0)][::-1]
    assert np.array_equal(forward, backward)
    assert (client.infer("c", 0) != forward[0]).any()


def test_episodes_do_not_share_memory(serving):
    class Counting(Policy):
        description = Description(name="counting", stateful=True)

        def reset(self, episode):
            episode.memory = 0

        def infer(self, observation):
            observation.episode.memory += 1
            return np.full(7, observation.episode.memory / 10)

    client = serving(Counting())
    client.reset("a")
    client.reset("b")
    answers = [client.infer(session, index)[0, 0] for index in (0, 1) for session in "ab"]
    assert np.allclose(answers, [0.1, 0.1, 0.2, 0.2])
    # A stateful policy is not advanced by a retry or by a query out of order.
    assert np.isclose(client.infer("a", 1)[0, 0], 0.2)
    code, text = refusal(client.infer, "a", 5)
    assert code == grpc.StatusCode.FAILED_PRECONDITION and "query 2 is next" in text
    assert np.isclose(client.infer("a", 2)[0, 0], 0.3)
    client.reset("a")
    assert np.isclose(client.infer("a", 0)[0, 0], 0.1)


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (np.full((1, 7), np.nan), "component 0 of action 0 is nan"),
        (np.zeros((1, 6)), "[1, 6]"),
        (np.zeros((0, 7)), "0 actions"),
        (np.zeros((3, 7)), "3 actions"),
        ("left", "not an array of numbers"),
        (RuntimeError("CUDA error:\nout of memory"), "RuntimeError: CUDA error: out of memory"),
    ],
)
def test_an_error_of_the_policy_is_one_line_without_session_and_query(serving, answer, expected):
    client = serving(Answering(answer))
    client.reset("object/t0/nominal/L0/c00#r0#a1")
    code, text = refusal(client.infer, "object/t0/nominal/L0/c00#r0#a1", 9)
    assert code == grpc.StatusCode.INTERNAL
    assert expected in text and "\n" not in text
    # The caller knows policy, session and query, and a campaign shows them beside the text.
    assert "crooked" not in text and "object/t0" not in text and "query" not in text


def test_the_error_of_a_failing_reset_has_its_exception(serving):
    class Refusing(Answering):
        def reset(self, episode):
            raise KeyError(episode.instruction)

    code, text = refusal(serving(Refusing(None)).reset, "s", instruction="fly")
    assert code == grpc.StatusCode.INTERNAL
    assert text == "reset raised KeyError: 'fly'"


def test_the_health_service_answers(serving):
    call = serving(Noisy()).channel.unary_unary("/grpc.health.v1.Health/Check")
    name = b"rollout.policy.v1.Policy"
    assert call(b"") == b"\x08\x01"
    assert call(b"\x0a" + bytes([len(name)]) + name) == b"\x08\x01"
    assert refusal(call, b"\x0a\x03abc")[0] == grpc.StatusCode.NOT_FOUND


def test_a_port_that_is_taken_is_named():
    first = start(Noisy())
    try:
        with pytest.raises(OSError, match=re.escape(first.address)):
            start(Noisy(), first.address)
    finally:
        first.stop(0)


def test_an_inconsistent_description_is_refused_at_construction():
    with pytest.raises(ValueError, match="execute is 9 and horizon 8"):
        Description(name="p", horizon=8, execute=9)
    with pytest.raises(ValueError, match="a policy needs a name"):
        Description(name="")
    with pytest.raises(ValueError, match="horizon is 2000, not within 1..1040"):
        Description(name="p", horizon=2000)
    with pytest.raises(ValueError, match="setting 'revision' is 3;.* must be strings"):
        Description(name="p", settings={"revision": 3})
    with pytest.raises(ValueError, match="checkpoint has 513 bytes, and results hold at most 512"):
        Description(name="p", checkpoint="x" * 513)
    with pytest.raises(ValueError, match="a reading is named twice"):
        Description(name="p", state=(State.EEF_POS, State.EEF_POS))


@pytest.mark.parametrize(
    ("attributes", "expected"),
    [
        ({}, "policy Nameless has no description: write `description = Description"),
        ({"description": {"name": "p"}}, "description of policy Nameless is of type dict, not"),
    ],
)
def test_the_error_for_a_missing_description_has_the_line_to_write(attributes, expected):
    methods = {"reset": lambda *_: None, "infer": lambda *_: None}
    nameless = type("Nameless", (Policy,), {**methods, **attributes})
    with pytest.raises(UnusableDescription, match=expected):
        start(nameless())
    with pytest.raises(UnusableDescription, match="create one"):
        start(nameless)


def test_the_example_names_its_port_serves_and_stops_on_sigterm():
    command = [sys.executable, "-m", "rollout_policies.examples.colour_servo"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        line = process.stdout.readline()
        client = Client(re.fullmatch(r"listening on (127\.0\.0\.1:\d+)\n", line)[1])
        assert client.describe().name == "colour-servo"
        client.channel.close()
        os.kill(process.pid, signal.SIGTERM)
        assert process.wait(timeout=30) == 0
