"""Batched queries: an answer does not depend on its batch, and only the faulty query fails."""

import pathlib
import re

import grpc
import numpy as np
import pytest
from conftest import Noisy, Plain, refusal

from rollout_policies import Description
from rollout_policies.broken import BROKEN_WORDS
from rollout_policies.proto import policy_pb2 as pb


def test_a_query_of_a_batch_fails_alone_and_answers_do_not_depend_on_the_batch(serving):
    class Batched(Noisy):
        description = Description(name="batched", horizon=4, stochastic=True, max_batch=3)
        sizes = []

        def infer_batch(self, observations):
            self.sizes.append(len(observations))
            return super().infer_batch(observations)

    policy = Batched()
    client = serving(policy)
    for session in "abc":
        client.reset(session, seed=ord(session))
    alone = client.infer("c", 1)
    queries = [client.request("a", 1), client.request("b", 1), client.request("c", 1)]
    results = client.stub.InferBatch(pb.InferBatchRequest(queries=queries)).results
    assert policy.sizes == [2]  # c is answered from memory
    assert np.allclose(results[2].response.actions, alone.ravel())
    client.reset("d", seed=ord("a"))
    assert np.allclose(results[0].response.actions, client.infer("d", 1).ravel())

    code, text = refusal(client.stub.InferBatch, pb.InferBatchRequest(queries=queries * 2))
    assert code == grpc.StatusCode.INVALID_ARGUMENT and "at most 3" in text


class Batching(Plain):
    """Raises `error` for a query of the session "bad", alone or in a batch."""

    def __init__(self, error, stateful=False):
        self.description = Description(name="batching", max_batch=4, stateful=stateful)
        self.error, self.single_queries = error, []

    def infer(self, observation):
        self.single_queries.append(observation.episode.session)
        return self.answers([observation])[0]

    def infer_batch(self, observations):
        return self.answers(observations)

    def answers(self, observations):
        if any(observation.episode.session == "bad" for observation in observations):
            raise self.error
        return [np.full(7, 0.5) for _ in observations]


def batch_results(client):
    """Returns the actions, or else the error, of each query of a batch."""
    for session in ("a", "bad", "b"):
        client.reset(session)
    queries = [client.request(session) for session in ("a", "bad", "b")]
    results = client.stub.InferBatch(pb.InferBatchRequest(queries=queries)).results
    return [result.error or list(result.response.actions) for result in results]


def test_only_the_faulty_query_of_a_batch_fails(serving):
    policy = Batching(KeyError("butter"))
    first, faulty, last = batch_results(serving(policy))
    assert first == last == [0.5] * 7
    assert faulty == "infer raised KeyError: 'butter'"
    assert policy.single_queries == ["a", "bad", "b"]


def test_a_batch_with_too_few_answers_is_repeated_query_by_query(serving):
    class AnsweringTooFew(Batching):
        def infer_batch(self, observations):
            return super().infer_batch(observations[:1])

    policy = AnsweringTooFew(KeyError("butter"))
    client = serving(policy)
    assert [len(result) == 7 for result in batch_results(client)] == [True, False, True]


@pytest.mark.parametrize(
    "policy",
    [
        Batching(RuntimeError("CUDA error: device-side assert triggered")),
        # The memories of a stateful policy's episodes may have advanced already.
        Batching(KeyError("butter"), stateful=True),
    ],
    ids=["unrecoverable error", "stateful"],
)
def test_a_failed_batch_of_a_stateful_or_broken_policy_fails_as_a_whole(serving, policy):
    results = batch_results(serving(policy))
    assert all(result.startswith("infer raised ") for result in results)
    assert policy.single_queries == []


def test_after_an_unrecoverable_error_the_rest_of_a_batch_is_not_queried(serving):
    class FailingBatch(Batching):
        def infer_batch(self, observations):
            raise ValueError("the batch failed")

    policy = FailingBatch(RuntimeError("CUDA out of memory"))
    first, faulty, last = batch_results(serving(policy))
    assert first == [0.5] * 7
    assert "out of memory" in faulty and "out of memory" in last
    assert policy.single_queries == ["a", "bad"]


def test_the_gateway_has_the_same_words_of_unrecoverable_errors():
    source = pathlib.Path(__file__).parents[2] / "policy-gateway" / "src" / "health.rs"
    words = re.search(r"FATAL_PHRASES: \[&str; \d+\] = \[(.*?)\]", source.read_text(), re.DOTALL)
    assert tuple(re.findall(r'"(.*?)"', words[1])) == BROKEN_WORDS
