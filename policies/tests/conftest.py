"""Real servers on free loopback ports, and a client for them."""

import contextlib
import os
import subprocess

import grpc
import numpy as np
import pytest

from rollout_policies import Camera, Description, Policy, State, check, start
from rollout_policies.proto import policy_pb2 as pb


class Stub:
    """The protocol's calls on a channel, by name."""

    def __init__(self, channel):
        service = pb.DESCRIPTOR.services_by_name["Policy"]
        for call in service.methods:
            method = channel.unary_unary(
                f"/{service.full_name}/{call.name}",
                request_serializer=getattr(pb, call.input_type.name).SerializeToString,
                response_deserializer=getattr(pb, call.output_type.name).FromString,
            )
            setattr(self, call.name, method)


class Client:
    """Calls a server as a worker does."""

    def __init__(self, address):
        self.channel = grpc.insecure_channel(address)
        self.stub = Stub(self.channel)

    def describe(self, version=1, policy=""):
        return self.stub.Describe(pb.DescribeRequest(protocol_version=version, policy=policy))

    def reset(self, session="s", seed=7, **fields):
        self.stub.Reset(pb.ResetRequest(session=session, seed=seed, **fields))

    def end(self, session="s"):
        self.stub.End(pb.EndRequest(session=session))

    def infer(self, session="s", query_index=0, observation=None):
        response = self.stub.Infer(self.request(session, query_index, observation))
        assert response.action_width == 7
        return np.array(response.actions, dtype=np.float32).reshape(-1, 7)

    def request(self, session="s", query_index=0, observation=None):
        observation = observation or pb.Observation()
        return pb.InferRequest(session=session, query_index=query_index, observation=observation)


@pytest.fixture
def serving():
    """Starts servers and stops them at the end: `serving(policy) -> Client`."""
    with contextlib.ExitStack() as stack:

        def start_server(policy):
            server = start(policy)
            stack.callback(server.stop, 0)
            client = Client(server.address)
            stack.callback(client.channel.close)
            return client

        yield start_server


class Plain(Policy):
    """Answers zeros."""

    description = Description(name="plain")

    def reset(self, episode):
        pass

    def infer(self, observation):
        return np.zeros(7)


class Noisy(Policy):
    """Answers random numbers and counts its queries."""

    description = Description(name="noisy", horizon=4, stochastic=True)

    def __init__(self):
        self.query_count = 0

    def reset(self, episode):
        episode.memory = []

    def infer(self, observation):
        self.query_count += 1
        return observation.rng.uniform(-1, 1, (4, 7))


class Recording(Policy):
    """Keeps the observations that it receives."""

    description = Description(
        name="recording",
        cameras=(Camera("agentview", 3, 2),),
        state=(State.EEF_POS, State.GRIPPER_POS),
    )

    def reset(self, episode):
        self.episode = episode

    def infer(self, observation):
        self.observation = observation
        return np.zeros(7)


class Answering(Plain):
    """Answers its constructor's argument, or raises it if it is an exception."""

    description = Description(name="crooked", horizon=2)

    def __init__(self, answer):
        self.answer = answer

    def infer(self, observation):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


def refusal(call, *arguments, **fields):
    """Returns code and text of a refused call."""
    with pytest.raises(grpc.RpcError) as caught:
        call(*arguments, **fields)
    return caught.value.code(), caught.value.details()


@pytest.fixture
def received(tmp_path):
    """File in which a server of another protocol records what it receives."""
    return tmp_path / "received.jsonl"


@pytest.fixture
def program():
    return gateway_program()


def gateway_program():
    """Returns the path in the environment variable POLICY_GATEWAY, or skips the test."""
    program = os.environ.get("POLICY_GATEWAY")
    if program is None:
        pytest.skip("POLICY_GATEWAY does not name the policy-gateway program")
    return program


def assert_gateway_check_passes(url, *arguments):
    """Runs the gateway's conformance check on a server."""
    check = subprocess.run(
        [gateway_program(), "check", url, *arguments], capture_output=True, text=True
    )
    print(check.stdout)
    assert check.returncode == 0, check.stdout + check.stderr


def assert_conforms(policy):
    """Runs the gateway's conformance check on a policy of this process."""
    gateway_program()
    print(check(policy))


@contextlib.contextmanager
def running(*command, **options):
    """Runs a server as a separate process; yields the process, and the address that it prints."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **options)
    try:
        line = process.stdout.readline()
        assert line.startswith("listening on "), line
        yield process, line.split()[2]
    finally:
        process.terminate()
        process.wait(timeout=60)
        process.stdout.close()


@contextlib.contextmanager
def serving_at(command):
    """Runs a server as a separate process; yields its address."""
    with running(*command) as (_, address):
        yield address


@contextlib.contextmanager
def client_behind(program, *arguments):
    """Runs a gateway with these arguments; yields a client of it."""
    with serving_at([program, "--listen", "127.0.0.1:0", *arguments]) as address:
        client = Client(address)
        yield client
        client.channel.close()
