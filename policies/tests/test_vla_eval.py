"""A model server of the real vla-eval behind the gateway receives the messages that vla-eval's own
LIBERO benchmark sends, and its answers are executed in the same way.

Runs the program that the environment variable POLICY_GATEWAY names."""

import json
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import grpc
import numpy as np
import pytest
from conftest import client_behind, refusal, serving_at

from rollout_policies.proto import policy_pb2 as pb

pytest.importorskip("vla_eval", reason="vla-eval is not installed")
pytest.importorskip("anyio", reason="anyio is not installed")
import anyio  # noqa: E402
from recording_vla_eval_server import scripted_action, to_json  # noqa: E402
from vla_eval.benchmarks.libero.benchmark import LIBEROBenchmark  # noqa: E402
from vla_eval.connection import Connection  # noqa: E402
from vla_eval.runners.sync_runner import SyncEpisodeRunner  # noqa: E402

SERVER = Path(__file__).parent / "recording_vla_eval_server.py"
BENCHMARK = "vla_eval.benchmarks.libero.benchmark:LIBEROBenchmark"
SUITE = "libero_goal"
ALL_INPUTS = {"send_wrist_image": True, "send_state": True}
STEPS = 6


def serving(received, *arguments, **params):
    command = [sys.executable, str(SERVER), "--received", str(received)]
    return serving_at([*command, "--params", json.dumps(params), *arguments])


def gateway(program, server, options=""):
    return client_behind(program, "--route", f"x=vla-eval://{server}{options}")


def lines(received):
    return [json.loads(line) for line in received.read_text().splitlines()]


def messages(received):
    return [line for line in lines(received) if line["type"] != "disconnected"]


def until(condition, seconds=30):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def rotation_of(quaternion):
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def simulated_observations():
    """Yields synthetic observations of a few steps in robosuite's form. Their orientations include
    rotations near half a turn, as of the hand at rest, with quaternions of either sign."""
    generator = np.random.default_rng(3)
    quaternions = generator.normal(size=(STEPS, 4))
    quaternions[0] = (0.9999, 0.001, -0.002, 0.0003)
    quaternions[1] = (-0.9999, 0.001, 0.003, -0.0004)
    quaternions[2] = (0, 0, 0, 1)
    for quaternion in quaternions:
        yield {
            "agentview_image": generator.integers(0, 256, (256, 256, 3), dtype=np.uint8),
            "robot0_eye_in_hand_image": generator.integers(0, 256, (256, 256, 3), dtype=np.uint8),
            "robot0_eef_pos": generator.uniform(-1, 1, 3),
            "robot0_eef_quat": quaternion / np.linalg.norm(quaternion),
            "robot0_gripper_qpos": generator.uniform(-0.04, 0.04, 2),
        }


def observation(simulated):
    images = [
        pb.Image(camera=camera, width=256, height=256, rgb=simulated[f"{camera}_image"].tobytes())
        for camera in ("agentview", "robot0_eye_in_hand")
    ]
    quaternion = simulated["robot0_eef_quat"]
    readings = {
        pb.STATE_FIELD_EEF_POS: simulated["robot0_eef_pos"],
        pb.STATE_FIELD_EEF_QUAT_XYZW: quaternion,
        pb.STATE_FIELD_EEF_ROTATION: rotation_of(quaternion).ravel(),
        pb.STATE_FIELD_GRIPPER_POS: simulated["robot0_gripper_qpos"],
    }
    state = [pb.StateReading(field=field, values=values) for field, values in readings.items()]
    return pb.Observation(images=images, state=state)


OBSERVATION = observation(next(simulated_observations()))


class ReplayedBenchmark(LIBEROBenchmark):
    """vla-eval's LIBERO benchmark, with synthetic observations in place of the simulator.

    The controller's site is turned relative to the hand as in robosuite's Panda gripper
    (`panda_gripper.xml`: -90 degrees about z)."""

    def reset(self, task):
        self.remaining = simulated_observations()
        self.executed = []
        self._env = self
        return self.next()

    def next(self):
        simulated = next(self.remaining, None)
        if simulated is not None:
            turn = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
            controller = SimpleNamespace(
                ee_pos=simulated["robot0_eef_pos"],
                ee_ori_mat=rotation_of(simulated["robot0_eef_quat"]) @ turn,
            )
            self.robots = [SimpleNamespace(controller=controller)]
        return simulated

    def close(self):
        pass

    def step(self, action):
        # vla-eval's runner passes a dictionary. The base class then steps its environment, which
        # is this object, with an array.
        if isinstance(action, dict):
            return super().step(action)
        self.executed.append(action)
        return self.next() or {name: np.zeros(4) for name in STATE_NAMES}, 0.0, False, {}


STATE_NAMES = ("robot0_eef_pos", "robot0_eef_quat", "robot0_gripper_qpos")


def wait_for_episode_end(received):
    until(lambda: messages(received)[-1]["type"] == "episode_end")


def played_by_vla_eval(server, instruction, **params):
    """Plays one episode with vla-eval's own client. Returns the executed actions."""
    benchmark = ReplayedBenchmark(SUITE, **params)

    async def play():
        connection = Connection(f"ws://{server}")
        await connection.connect(benchmark=BENCHMARK)
        task = {"name": instruction, "suite": SUITE, "task_id": 3, "episode_idx": 0}
        # The episode ends with its last step, because no observation after that step is simulated.
        runner = SyncEpisodeRunner()
        benchmark.check_done = lambda step: len(benchmark.executed) == STEPS
        await runner.run_episode(benchmark, task, connection, max_steps=STEPS)
        await connection.close()

    anyio.run(play)
    return np.array(benchmark.executed, dtype=np.float32)


def played_by_the_gateway(program, server, received, instruction):
    with gateway(program, server) as client:
        client.reset(suite=SUITE, instruction=instruction)
        actions = [
            client.infer(query_index=at, observation=observation(simulated))
            for at, simulated in enumerate(simulated_observations())
        ]
        client.stub.End(pb.EndRequest(session="s"))
        # The gateway forwards the end in the background.
        wait_for_episode_end(received)
    return np.concatenate(actions)


def assert_alike(ours, theirs):
    """Checks that two recorded messages are equal, except that floats may differ in the last bit
    of single precision."""
    if isinstance(theirs, dict):
        assert list(ours) == list(theirs), "the same keys in the same order"
        for key, value in theirs.items():
            assert_alike(ours[key], value)
    elif isinstance(theirs, list) and theirs[0] in ("<f4", "<f8"):
        assert ours[:2] == theirs[:2]
        np.testing.assert_allclose(ours[2:], theirs[2:], rtol=3e-7, atol=3e-7)
    else:
        assert ours == theirs


@pytest.mark.parametrize(
    "params",
    [{}, ALL_INPUTS, {**ALL_INPUTS, "quat_no_antipodal": True, "env_seed": 0}],
    ids=["an image", "everything", "quaternions as they are"],
)
@pytest.mark.parametrize("chunk_size", [None, 4], ids=["single actions", "chunks"])
def test_the_server_receives_the_messages_of_vla_evals_own_benchmark(
    program, received, tmp_path, params, chunk_size
):
    expected_file = tmp_path / "theirs.jsonl"
    arguments = [] if chunk_size is None else ["--chunk-size", str(chunk_size)]
    instruction = "pick it up" if chunk_size is None else "answer a chunk"
    with serving(expected_file, *arguments, **params) as server:
        theirs = played_by_vla_eval(server, instruction, **params)
        wait_for_episode_end(expected_file)
    with serving(received, *arguments, **params) as server:
        ours = played_by_the_gateway(program, server, received, instruction)
    assert ours.shape == (STEPS, 7)
    np.testing.assert_array_equal(ours, theirs)
    assert set(ours[:, 6]) == {-1, 1}

    expected = messages(expected_file)
    # The gateway requests the description before every Reset, and uses the connection of that
    # request for the episode.
    hello, *episode = messages(received)
    assert [line["type"] for line in episode] == [line["type"] for line in expected][1:]
    start, *observations, end = expected[1:]
    assert_alike(hello, expected[0])
    del start["payload"]["task"]["task_id"], start["payload"]["task"]["episode_idx"]
    assert_alike(episode[0], start)
    assert len(observations) == STEPS
    for ours, theirs in zip(episode[1:-1], observations):
        assert_alike(ours, theirs)
    assert episode[-1]["seq"] == end["seq"] and episode[-1]["payload"] == {}


@pytest.mark.parametrize("form, sent", [("png", "png"), ("raw", "|u1"), ("jpeg", "jpeg")])
def test_frames_are_sent_in_each_image_format(program, received, form, sent):
    # Smooth waves, because JPEG is meant for pictures, not for noise.
    y, x = np.mgrid[:256, :256] / 16
    waves = np.stack([np.sin(x) + np.cos(y), np.sin(x + y), np.cos(x - y)], axis=-1)
    frame = np.uint8(127 + 60 * waves)
    simulated = {**next(simulated_observations()), "agentview_image": frame}
    with serving(received) as server:
        with gateway(program, server, f"?image_format={form}") as client:
            client.reset(suite=SUITE, instruction="reach")
            client.infer(observation=observation(simulated))
    [sent_line] = [line for line in messages(received) if line["type"] == "observation"]
    assert sent_line["forms"] == {"agentview": sent}
    dtype, *shape, digest, mean = sent_line["payload"]["images"]["agentview"]
    assert (dtype, shape) == ("|u1", [256, 256, 3])
    turned = np.ascontiguousarray(frame[::-1, ::-1])
    is_lossless = to_json(turned)[4] == digest
    assert is_lossless == (form != "jpeg")
    np.testing.assert_allclose(mean, turned.mean(axis=(0, 1)), atol=1)


def test_execute_in_the_address_executes_the_servers_chunks(program, received):
    with serving(received) as server:
        # vla-eval's own client takes one action per answer: a server must split its chunks.
        with pytest.raises(Exception, match="Action dimension mismatch: got 6"):
            played_by_vla_eval(server, "answer a chunk")
        with gateway(program, server) as client:
            client.reset(suite=SUITE, instruction="answer a chunk")
            code, text = refusal(client.infer, observation=OBSERVATION)
            assert code == grpc.StatusCode.INTERNAL
            assert "a chunk of 6 actions" in text
            assert "?execute=6" in text
        with gateway(program, server, "?execute=5") as client:
            description = client.describe()
            assert (description.horizon, description.execute) == (5, 5)
            client.reset(suite=SUITE, instruction="answer a chunk")
            actions = client.infer(observation=OBSERVATION)
            expected = np.float32([scripted_action(step) for step in range(5)])
            np.testing.assert_array_equal(actions[:, :6], expected[:, :6])
            assert actions[:, 6].tolist() == [1, -1, 1, -1, 1]
            client.reset("t", suite=SUITE, instruction="reach")
            _, text = refusal(client.infer, "t", observation=OBSERVATION)
            assert "leave out ?execute" in text


def test_every_episode_has_its_own_connection_and_chunks(program, received):
    with serving(received, "--chunk-size", "4") as server, gateway(program, server) as client:
        for session in ("a", "b"):
            client.reset(session, suite=SUITE, instruction="answer a chunk")
        for step in range(3):
            for session in ("a", "b"):
                action = client.infer(session, step, OBSERVATION)
                expected = np.float32(scripted_action(step))
                np.testing.assert_array_equal(action[0, :6], expected[:6])
        assert not [line for line in lines(received) if line["type"] == "disconnected"]
        client.stub.End(pb.EndRequest(session="a"))
        until(lambda: [line for line in lines(received) if line["type"] == "disconnected"])
        assert [line["type"] for line in lines(received)][-2:] == ["episode_end", "disconnected"]
        code, _ = refusal(client.infer, "a", 3, OBSERVATION)
        assert code == grpc.StatusCode.UNAVAILABLE
        client.infer("b", 3, OBSERVATION)


def test_the_description_has_resolved_settings_and_the_address_takes_precedence(program, received):
    parameters = {"send_state": True, "env_seed": 0, "success_mode": "truncation"}
    with serving(received, "--gripper", "binary_close_positive", **parameters) as server:
        with gateway(program, server) as client:
            description = client.describe()
        with gateway(program, server, "?send_wrist_image=true&send_state=false") as client:
            other = client.describe()
    assert description.name == "Policy"
    assert description.checkpoint.startswith("not named by its server")
    assert description.stateful and description.stochastic and description.unseeded
    assert description.batch_mode == "single, unseeded"
    settings = {setting.name: setting.value for setting in description.settings}
    assert settings.pop("connected since").startswith("127.0.0.1:")
    assert settings == {
        "server": "Policy of vla-eval 0.8.0",
        "observation parameters": 'send_state=true, env_seed=0, success_mode="truncation"',
        "left to the campaign": "env_seed",
        "observation spec": "none",
        "action spec": "gripper=binary_close_positive",
        "image slots": "agentview=agentview",
        "image format": "png",
        "state": "eef_pos3_axisangle3_gripper2, nearer antipode",
        "controller states": "of the instant of observation, not of the end of the control step",
        "gripper": "open below 0, else closed",
    }
    settings = {setting.name: setting.value for setting in other.settings}
    assert settings["image slots"] == "agentview=agentview, wrist=robot0_eye_in_hand"
    assert settings["state"] == "none" and not other.state
    assert [camera.name for camera in other.cameras] == ["agentview", "robot0_eye_in_hand"]


@pytest.mark.parametrize(
    "arguments, params, words",
    [
        ([], {"absolute_action": True}, "serve a checkpoint of relative actions"),
        ([], {"send_state": "yes"}, "neither true nor false"),
        (["--gripper", "continuous_01"], {}, "it would never open"),
        (["--gripper", "binary_close_negative"], {}, "it would open where it should close"),
        ([], {"suite": "libero_spatial"}, "give the policy a server per suite"),
    ],
)
def test_unsupported_configurations_are_refused_with_the_reason(
    program, received, arguments, params, words
):
    with serving(received, *arguments, **params) as server, gateway(program, server) as client:
        code, text = refusal(client.reset, suite=SUITE, instruction="reach")
    assert code == grpc.StatusCode.FAILED_PRECONDITION and words in text


@pytest.mark.parametrize(
    "instruction, words",
    [
        ("raise", "ValueError: the policy does not like this instruction"),
        ("answer nothing", 'its answer has no "actions"'),
        ("answer a cube", "its actions have shape [2, 3, 7]"),
        ("refuse to start", "episode_start_failed: KeyError: 'no such task'"),
    ],
)
def test_an_error_of_the_policy_is_reported_and_the_next_query_is_answered(
    program, received, instruction, words
):
    with serving(received) as server, gateway(program, server) as client:
        client.reset(suite=SUITE, instruction=instruction)
        code, text = refusal(client.infer, observation=OBSERVATION)
        assert code == grpc.StatusCode.INTERNAL and words in text
        client.reset("t", suite=SUITE, instruction="reach")
        assert client.infer("t", observation=OBSERVATION).shape == (1, 7)


def test_a_list_of_numbers_is_accepted_as_an_action(program, received):
    with serving(received) as server, gateway(program, server) as client:
        client.reset(suite=SUITE, instruction="answer a list")
        assert client.infer(observation=OBSERVATION).tolist() == [[0.5, 0, 0, 0, 0, 0, -1]]


def test_the_server_passes_the_conformance_check_except_for_seeds(program, received):
    with serving(received, "--chunk-size", "4", **ALL_INPUTS) as server:
        check = subprocess.run(
            [program, "check", f"vla-eval://{server}", "--suite", SUITE],
            capture_output=True,
            text=True,
        )
    assert check.returncode == 0, check.stdout + check.stderr
    assert "skip  the same seed gives the same actions: the policy's random numbers" in check.stdout
    assert "pass  a retry gets the same actions" in check.stdout
