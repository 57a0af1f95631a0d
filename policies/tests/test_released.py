"""Servers of the first release still work, although they lack End and settings."""

import pathlib
import sys

import grpc
import pytest
from conftest import (
    Client,
    assert_gateway_check_passes,
    gateway_program,
    running,
)

from rollout_policies.conformance import Target, check_server
from rollout_policies.conformance.points import Point
from rollout_policies.conformance.probe import to_message
from rollout_policies.conformance.verdict import Word
from rollout_policies.description import Description
from rollout_policies.fake import fake_observation

SERVER = pathlib.Path(__file__).parent / "server_0_1.py"


@pytest.fixture(scope="module")
def released():
    """The address of a server of the first release."""
    with running(sys.executable, str(SERVER)) as (_, address):
        yield address


def scene(client):
    """Returns a synthetic observation for the described policy."""
    described = Description.from_message(client.describe())
    return to_message(fake_observation(described))


def test_this_packages_check_finds_that_a_released_server_conforms(released):
    findings = check_server(Target(f"grpc://{released}"))
    by_point = {finding.point: finding.verdict for finding in findings}
    assert not any(verdict.failed for verdict in by_point.values()), findings
    assert by_point[Point.END].word is Word.SKIP
    assert by_point[Point.BATCH].word is Word.PASS


def test_the_gateways_check_finds_that_a_released_server_conforms(released):
    assert_gateway_check_passes(f"grpc://{released}")


def test_a_released_server_works_after_the_end_of_an_episode(released):
    client = Client(released)
    client.reset("a")
    before = client.infer("a", observation=scene(client))
    with pytest.raises(grpc.RpcError) as caught:
        client.end("a")
    assert caught.value.code() == grpc.StatusCode.UNIMPLEMENTED
    assert (client.infer("a", observation=scene(client)) == before).all()
    client.channel.close()


def test_behind_a_gateway_a_released_server_answers_episode_after_episode(released):
    route = f"released=grpc://{released}"
    command = [gateway_program(), "--listen", "127.0.0.1:0", "--route", route]
    with running(*command) as (_, address):
        client = Client(address)
        assert list(client.describe().settings) == []
        answers = []
        for name in ("a", "b", "a"):
            client.reset(name)
            answers.append(client.infer(name, observation=scene(client)))
            client.end(name)
        assert all((answer == answers[0]).all() for answer in answers)
        client.channel.close()
