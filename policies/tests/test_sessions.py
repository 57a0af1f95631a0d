"""Ends of episodes, and the release of the state that the server keeps for an open episode."""

import time

import grpc
import numpy as np
from conftest import refusal

from rollout_policies import Description, Episode, Policy, service
from rollout_policies.proto import policy_pb2 as pb
from rollout_policies.sessions import Session, SessionTable


class Remembering(Policy):
    """Keeps state of every episode, and records the ended ones."""

    description = Description(name="remembering")

    def __init__(self):
        self.ended = []
        self.episodes = []

    def reset(self, episode):
        episode.memory = f"of {episode.session}"
        self.episodes.append(episode)

    def infer(self, observation):
        return np.zeros(7)

    def end(self, episode):
        self.ended.append((episode.session, episode.memory))


def code_of(call, *arguments):
    return refusal(call, *arguments)[0]


def test_the_end_of_an_episode_calls_end_and_releases_its_memory(serving):
    policy = Remembering()
    client = serving(policy)
    client.reset("a")
    client.infer("a")
    client.end("a")
    # `End` returns before the policy's `end` is called. This Reset is queued after that call.
    client.reset("b")
    assert policy.ended == [("a", "of a")]
    assert [episode.memory for episode in policy.episodes] == [None, "of b"]
    # Neither a retry nor a further query is answered.
    for query_index in (0, 1):
        assert code_of(client.infer, "a", query_index) == grpc.StatusCode.UNAVAILABLE


def test_the_end_of_a_session_that_is_not_open_is_no_error(serving):
    policy = Remembering()
    client = serving(policy)
    client.end("never opened")
    client.reset("a")
    client.end("a")
    client.end("a")
    client.reset("b")
    assert policy.ended == [("a", "of a")]


def test_an_end_for_another_policy_is_refused(serving):
    policy = Remembering()
    client = serving(policy)
    client.reset("a")
    request = pb.EndRequest(policy="pi05", session="a")
    assert code_of(client.stub.End, request) == grpc.StatusCode.NOT_FOUND
    client.infer("a")
    assert policy.ended == []


def test_a_repeated_reset_ends_the_earlier_episode(serving):
    policy = Remembering()
    client = serving(policy)
    client.reset("a")
    client.reset("a")
    assert policy.ended == [("a", "of a")]
    assert [episode.memory for episode in policy.episodes] == [None, "of a"]


def test_an_exception_in_end_is_only_logged(serving):
    class FailingEnd(Remembering):
        def end(self, episode):
            raise RuntimeError("no such file")

    policy = FailingEnd()
    client = serving(policy)
    client.reset("a")
    client.end("a")
    client.reset("b")
    client.infer("b")
    assert [episode.memory for episode in policy.episodes] == [None, "of b"]


def test_the_idlest_episode_ends_when_there_are_too_many(serving, monkeypatch):
    monkeypatch.setattr("rollout_policies.server.SessionTable", lambda: SessionTable(most=2))
    policy = Remembering()
    client = serving(policy)
    client.reset("a")
    client.reset("b")
    client.infer("a")
    client.reset("c")
    assert policy.ended == [("b", "of b")]
    client.infer("a", 1)


def test_an_idle_episode_ends_without_a_further_call(serving, monkeypatch):
    now = [0.0]
    table = SessionTable(idle_secs=10.0, clock=lambda: now[0])
    monkeypatch.setattr("rollout_policies.server.SessionTable", lambda: table)
    swept = []

    class Sweeping(service.PolicyService):
        def close_idle(self):
            super().close_idle()
            swept.append(now[0])

    monkeypatch.setattr("rollout_policies.server.PolicyService", Sweeping)
    monkeypatch.setattr("rollout_policies.server.SWEEP_SECS", 0.001)
    policy = Remembering()
    client = serving(policy)
    client.reset("a")
    client.reset("b")
    now[0] = 8.0
    client.infer("b")
    now[0] = 12.0
    while 12.0 not in swept:
        time.sleep(0.001)
    assert policy.ended == [("a", "of a")]
    assert code_of(client.infer, "a") == grpc.StatusCode.UNAVAILABLE
    client.infer("b", 1)


def test_a_reset_that_raises_opens_no_episode_and_ends_the_earlier_one(serving):
    class FailingReset(Remembering):
        def reset(self, episode):
            if self.episodes:
                raise ValueError("one is enough")
            super().reset(episode)

    policy = FailingReset()
    client = serving(policy)
    client.reset("a")
    assert code_of(client.reset, "a") == grpc.StatusCode.INTERNAL
    assert policy.ended == [("a", "of a")]
    assert code_of(client.infer, "a") == grpc.StatusCode.UNAVAILABLE


def test_a_session_table_is_bounded_in_number_and_idle_time():
    now = [0.0]
    table = SessionTable(most=3, idle_secs=5.0, clock=lambda: now[0])

    def session(name):
        return Session(Episode(name, "", "", 0))

    def names(sessions):
        return [session.episode.session for session in sessions]

    assert [names(table.open(session(name))) for name in "abc"] == [[], [], []]
    now[0] = 4.0
    assert table.get("a").episode.session == "a"
    assert names(table.open(session("d"))) == ["b"]
    now[0] = 6.0
    assert names(table.close_idle()) == ["c"]
    assert table.close_idle() == [] and len(table) == 2
    assert table.close("a").episode.session == "a"
    assert table.close("a") is None and table.get("a") is None
    now[0] = 9.5
    assert names(table.close_idle()) == ["d"] and len(table) == 0
