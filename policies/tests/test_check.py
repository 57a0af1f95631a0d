"""This package's own conformance check: conforming servers pass, and every violation is found at
its point."""

import dataclasses
import re
import subprocess
import sys
from concurrent import futures
from pathlib import Path

import grpc
import numpy as np
import pytest
from conftest import Noisy, running
from test_conformance import Batched, Remembering

from rollout_policies import (
    Camera,
    CannotCheck,
    Description,
    DoesNotConform,
    Policy,
    State,
    check,
    fake_observation,
    health,
    start,
)
from rollout_policies.conformance import Target, check_server
from rollout_policies.conformance.points import Point
from rollout_policies.conformance.verdict import Word
from rollout_policies.examples.colour_servo import ColourServo
from rollout_policies.fake import TASKS
from rollout_policies.processing.robot import axis_angle
from rollout_policies.proto import policy_pb2 as pb
from rollout_policies.proto import policy_pb2_grpc as pb_grpc

EXPECTED_TEXTS = {
    Point.SPEED: r"one by one p50 [\d.]+ ms, p99 [\d.]+ ms; 8 episodes at once p50 .* queries/s",
    Point.DESCRIPTION: r'".*", checkpoint ".*", horizon \d+, execute \d+',
}


@pytest.mark.parametrize(
    ("policy", "skipped"),
    [
        (Noisy(), {Point.BATCH}),
        (Batched(), set()),
        (Remembering(), {Point.BATCH, Point.ORDER}),
        (ColourServo(), {Point.BATCH}),
    ],
    ids=lambda case: case.description.name if isinstance(case, Policy) else "",
)
def test_a_conforming_policy_passes_every_point(policy, skipped):
    findings = check(policy)
    assert [finding.point for finding in findings] == list(Point)
    for finding in findings:
        expected = Word.SKIP if finding.point in skipped else Word.PASS
        assert finding.verdict.word is expected, finding
        assert re.search(EXPECTED_TEXTS.get(finding.point, ""), finding.verdict.text), finding


class Faulty(Noisy):
    """A policy that conforms to the protocol. A subclass overrides one member and adds a fault."""

    description = Description(name="faulty", horizon=4, stochastic=True, max_batch=4)


class Unseeded(Faulty):
    def infer(self, observation):
        return np.random.default_rng().uniform(-1, 1, (4, 7))


class SeedIgnoring(Faulty):
    def infer(self, observation):
        return np.zeros((4, 7))


class SecretlyStochastic(Faulty):
    description = dataclasses.replace(Faulty.description, stochastic=False)


class StateSharing(Faulty):
    """Keeps an episode's state in the policy instead of the episode."""

    def reset(self, episode):
        self.seed = episode.seed

    def infer(self, observation):
        return np.random.default_rng([self.seed, observation.query_index]).uniform(-1, 1, (4, 7))


class StateCarrying(Faulty):
    """Keeps undeclared state between queries."""

    def reset(self, episode):
        episode.memory = 0.0

    def infer(self, observation):
        noise = super().infer(observation)
        observation.episode.memory = (observation.episode.memory + noise[0, 0]) / 2
        return np.clip(noise + observation.episode.memory, -1, 1)


class BatchMixing(Faulty):
    def infer_batch(self, observations):
        answers = [self.infer(observation) for observation in observations]
        return [answer * 0.5 + sum(answers) / len(answers) * 0.5 for answer in answers]


class Millimetres(Faulty):
    def infer(self, observation):
        return 100 * super().infer(observation)


@pytest.mark.parametrize(
    ("policy", "failing", "expected"),
    [
        (Unseeded, Point.SAME_SEED, "at query 0 the actions differ"),
        (SeedIgnoring, Point.OTHER_SEED, "declares itself stochastic"),
        (SecretlyStochastic, Point.OTHER_SEED, "declares itself deterministic"),
        (StateSharing, Point.ISOLATION, "the actions differ"),
        (StateCarrying, Point.ORDER, "the actions differ"),
        (BatchMixing, Point.BATCH, "in a batch the actions differ by up to"),
        (Millimetres, Point.RANGE, "un-normalises actions"),
    ],
)
def test_a_policys_fault_fails_its_point(policy, failing, expected):
    with pytest.raises(DoesNotConform) as caught:
        check(policy())
    failed = {finding.point: finding.verdict.text for finding in caught.value.findings
              if finding.verdict.failed}  # fmt: skip
    assert expected in failed[failing]
    assert f"FAIL  {failing.value}: " in str(caught.value)


def test_a_policy_that_answers_nothing_cannot_be_checked():
    class Raising(Faulty):
        def infer(self, observation):
            raise KeyError("butter")

    with pytest.raises(CannotCheck, match="KeyError: 'butter'"):
        check(Raising())


def test_low_order_differences_in_batches_pass_with_a_note():
    class Rounding(Faulty):
        def infer_batch(self, observations):
            return [self.infer(observation) + 1e-5 for observation in observations]

    [batch] = [finding for finding in check(Rounding()) if finding.point is Point.BATCH]
    assert "actions depend on the batch" in batch.verdict.text


def test_a_policy_of_one_suite_is_checked_with_a_task_of_that_suite():
    class LiberoGoalOnly(Faulty):
        def reset(self, episode):
            assert episode.suite == "libero_goal" and "drawer" in episode.instruction

    with pytest.raises(CannotCheck, match="AssertionError"):
        check(LiberoGoalOnly())
    check(LiberoGoalOnly(), suite="libero_goal")


class FaultyService(pb_grpc.PolicyServicer):
    """A service that does not use this package, and violates the named points."""

    def __init__(self, *faults):
        self.faults = set(faults)
        self.seeds, self.retries = {}, {}

    def Describe(self, request, context):
        if request.protocol_version != 1 and "version" not in self.faults:
            context.abort(grpc.StatusCode.FAILED_PRECONDITION, "this server has version 1")
        execute = 9 if "description" in self.faults else 2
        return pb.DescribeResponse(
            protocol_version=1, name="wire", horizon=2, execute=execute, stochastic=True
        )

    def Reset(self, request, context):
        if "restart" not in self.faults or request.session not in self.seeds:
            self.seeds[request.session] = request.seed
        return pb.ResetResponse()

    def Infer(self, request, context):
        if "unopened" not in self.faults and request.session not in self.seeds:
            context.abort(grpc.StatusCode.UNAVAILABLE, "not open")
        seed, retry = self.seeds.get(request.session, 0), 0
        if "retry" in self.faults:
            retry = self.retries[request.session] = self.retries.get(request.session, -1) + 1
        rng = np.random.default_rng([seed, request.query_index, retry])
        count, width = (3 if "horizon" in self.faults else 2), (6 if "width" in self.faults else 7)
        actions = rng.uniform(-1, 1, count * width).astype(np.float32)
        if "nan" in self.faults:
            actions[9] = np.nan
        return pb.InferResponse(actions=actions.tolist(), action_width=width)

    def End(self, request, context):
        if "end" in self.faults and request.session not in self.seeds:
            context.abort(grpc.StatusCode.NOT_FOUND, "no such session")
        self.seeds.pop(request.session, None)
        return pb.EndResponse()


def findings_of(servicer, healthy=True):
    server = grpc.server(futures.ThreadPoolExecutor(16))
    pb_grpc.add_PolicyServicer_to_server(servicer, server)
    if healthy:
        server.add_generic_rpc_handlers((health.handler(),))
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    try:
        return check_server(Target(f"grpc://127.0.0.1:{port}"))
    finally:
        server.stop(0)


@pytest.mark.parametrize(
    ("fault", "failing", "expected"),
    [
        ("description", Point.DESCRIPTION, "execute is 9 and horizon 2"),
        ("version", Point.VERSION, "a caller of protocol version 2"),
        ("health", Point.HEALTH, "UNIMPLEMENTED"),
        ("width", Point.SHAPE, "6 numbers wide"),
        ("horizon", Point.SHAPE, "3 actions; its horizon is 2"),
        ("nan", Point.SHAPE, "component 2 of action 1 is nan"),
        ("retry", Point.RETRY, "at query 0 the actions differ"),
        ("restart", Point.RESTART, "the actions differ"),
        ("unopened", Point.UNOPENED, "without instruction and seed"),
        ("end", Point.END, "NOT_FOUND"),
        (None, None, None),
    ],
)
def test_a_servers_fault_fails_its_point(fault, failing, expected):
    findings = findings_of(FaultyService(fault), healthy=fault != "health")
    assert [finding.point for finding in findings] == list(Point)
    failed = {finding.point: finding.verdict.text for finding in findings if finding.verdict.failed}
    if failing is None:
        assert failed == {}
    else:
        assert expected in failed[failing]
    # With the fault "retry", actions depend on the number of queries: every comparison fails.
    if fault not in (None, "retry"):
        assert len(failed) == 1


def test_a_server_need_not_implement_end():
    class WithoutEnd(FaultyService):
        End = pb_grpc.PolicyServicer.End

    verdicts = {finding.point: finding.verdict for finding in findings_of(WithoutEnd())}
    assert not any(verdict.failed for verdict in verdicts.values()), verdicts
    assert verdicts[Point.END].word is Word.SKIP


# Command line.


def command(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "rollout_policies", "check", *arguments],
        capture_output=True,
        text=True,
    )


def test_check_prints_every_point_and_exits_with_0_for_a_conforming_server():
    with running(sys.executable, "-m", "rollout_policies.examples.colour_servo") as (_, address):
        done = command(f"grpc://{address}")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[-1] == "conforms" and len(lines) == len(Point) + 1
    assert all(line.startswith(("pass  ", "skip  ")) for line in lines[:-1])


def test_check_exits_with_1_for_a_server_that_does_not_conform():
    server = start(Millimetres())
    try:
        done = command(f"http://{server.address}")
    finally:
        server.stop(0)
    assert done.returncode == 1
    assert done.stdout.endswith("does not conform\n")
    assert "FAIL  actions lie within -1..1: the largest is " in done.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        (["grpc://127.0.0.1:1"], 1, "have grpc://127.0.0.1:1 describe its policy"),
        (["ws://127.0.0.1:1"], 1, "write grpc://HOST:PORT"),
        (["127.0.0.1:1"], 1, "write grpc://HOST:PORT"),
        (["https://127.0.0.1:1", "--ca", "missing"], 1, "failed to read missing"),
        (["grpc://127.0.0.1:1", "--suite", "libero_90"], 2, "invalid choice: 'libero_90'"),
        ([], 2, "url"),
    ],
)
def test_an_impossible_check_reports_the_reason(arguments, code, expected):
    done = command(*arguments)
    assert done.returncode == code
    assert expected in done.stderr and "Traceback" not in done.stderr


# Tests of synthetic observations.

ALL_INPUTS = Description(
    name="everything",
    cameras=(Camera("agentview", 64, 48), Camera("robot0_eye_in_hand", 5, 3)),
    state=tuple(State),
)


def test_a_synthetic_observation_has_the_requested_shape():
    synthetic = fake_observation(ALL_INPUTS)
    assert {name: frame.shape for name, frame in synthetic.images.items()} == {
        "agentview": (48, 64, 3),
        "robot0_eye_in_hand": (3, 5, 3),
    }
    assert all(frame.dtype == np.uint8 for frame in synthetic.images.values())
    assert len(synthetic.vector()) == sum(field.size for field in State)
    # In SI units, the readings of LIBERO's robot are below 4.
    assert all(np.abs(reading).max() < 4 for reading in synthetic.state.values())


def test_synthetic_observations_depend_on_seed_and_query():
    def bytes_of(*seed_and_query):
        synthetic = fake_observation(ALL_INPUTS, *seed_and_query)
        return synthetic.images["agentview"].tobytes() + synthetic.vector().tobytes()

    assert bytes_of(1, 2) == bytes_of(1, 2)
    assert len({bytes_of(1, 2), bytes_of(1, 3), bytes_of(2, 2)}) == 3


def test_synthetic_readings_describe_one_posture():
    state = fake_observation(ALL_INPUTS, 5).state
    x, y, z, w = quaternion = state[State.EEF_QUAT_XYZW]
    assert np.linalg.norm(quaternion) == pytest.approx(1)
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    assert state[State.EEF_ROTATION].reshape(3, 3) == pytest.approx(np.array(rotation))
    assert state[State.EEF_AXIS_ANGLE] == pytest.approx(axis_angle(quaternion))
    # The fingers point down.
    assert state[State.EEF_ROTATION][8] == pytest.approx(-1)


def test_the_synthetic_tasks_equal_those_of_the_gateways_check():
    source = Path(__file__).parents[2] / "crates/policies/policy-doctor/src/conformance/scene.rs"
    table = source.read_text().partition("pub const TASKS")[2].partition("];")[0]
    texts = re.findall(r'"(.*?)"', table)
    assert dict(zip(texts[::2], texts[1::2])) == TASKS
