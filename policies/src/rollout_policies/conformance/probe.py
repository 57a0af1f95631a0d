"""The requests of the check: a client that plays episodes of synthetic observations and returns
the answers. The module `verdict` judges them, except for calls with a yes-or-no result."""

from __future__ import annotations

import contextlib
import time
import uuid
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import grpc

from .. import health
from ..access import QUERYING_ROLES, AccessError, Tokens, is_loopback
from ..description import MAX_MESSAGE_BYTES, PROTOCOL_VERSION, Camera, Description, State
from ..episode import Observation
from ..fake import fake_episode, fake_observation
from ..proto import policy_pb2 as pb
from ..proto import policy_pb2_grpc as pb_grpc
from . import verdict
from .verdict import Verdict

#: Queries in one episode.
QUERIES = 5
#: Largest number of queries in one batch, and the time limit of an answer, s: as in the gateway.
MAX_BATCH_QUERIES = 64
ANSWER_WITHIN_SECS = 50.0
#: Seed of all synthetic observations; episodes differ only in their own seed.
SCENE_SEED = 0


class CannotCheck(Exception):
    """The check is impossible: for example, there is no server, no description or no token."""


@dataclass(frozen=True)
class Target:
    """The server and policy to check."""

    #: grpc://HOST:PORT or http://HOST:PORT, or with TLS https:// or grpcs://.
    url: str
    #: Name of the policy; empty if the server has only one.
    policy: str = ""
    #: Suite of the synthetic task.
    suite: str = "libero_object"
    #: Authority that signed the server's certificate, PEM; None uses the system's authorities.
    ca: str | Path | None = None
    tokens: Tokens | None = None


@dataclass
class EpisodeAnswers:
    """Answers of one episode."""

    #: Answers by query index.
    answers: list[pb.InferResponse] = field(default_factory=list)
    #: Latency of each query, in the order of sending, s.
    latencies: list[float] = field(default_factory=list)


class Probe(contextlib.AbstractContextManager):
    """A client of the server under check. An error of the server is raised as grpc.RpcError,
    except in methods that check for an error."""

    def __init__(self, target: Target) -> None:
        """Connects and requests the policy's description. Raises CannotCheck."""
        self._target = target
        self._channel, self._metadata = _connect(target)
        self._stub = pb_grpc.PolicyStub(self._channel)
        # Distinguishes this check's sessions from those of an earlier one.
        self._run = uuid.uuid4().hex[:8]
        try:
            #: The policy's own description.
            self.described: pb.DescribeResponse = self._describe(PROTOCOL_VERSION)
        except grpc.RpcError as error:
            self._channel.close()
            reason = verdict.describe_error(error)
            raise CannotCheck(
                f"failed to have {target.url} describe its policy: {reason}"
            ) from error
        if self.described.privileged:
            self._channel.close()
            raise CannotCheck(
                f"failed to check {self.described.name}: it requests the simulator's own state,"
                " which this check does not generate; use `policy-gateway check`"
            )
        try:
            self._scenes = [self._scene(query_index) for query_index in range(QUERIES)]
        except ValueError as error:
            self._channel.close()
            raise CannotCheck(f"failed to generate an observation: {error}") from error

    def __exit__(self, *_: object) -> None:
        self._channel.close()

    def other_version(self) -> Verdict:
        """Checks that a caller of a newer version is refused."""
        newer = PROTOCOL_VERSION + 1
        try:
            self._describe(newer)
        except grpc.RpcError as error:
            if error.code() == grpc.StatusCode.FAILED_PRECONDITION:
                return verdict.passed()
            return verdict.refused(error)
        return verdict.failed(f"it accepts a caller of protocol version {newer}")

    def health(self) -> Verdict:
        """Checks that the health service answers for policies."""
        name = b"rollout.policy.v1.Policy"
        check = self._channel.unary_unary("/grpc.health.v1.Health/Check")
        answer = check(bytes([health.SERVICE_TAG, len(name)]) + name, **self._options())
        if answer == health.SERVING:
            return verdict.passed()
        return verdict.failed("it does not report SERVING")

    def episode(
        self, name: str, seed: int, order: Iterable[int] = range(QUERIES)
    ) -> EpisodeAnswers:
        """Plays one episode with its queries in this order."""
        self._reset(name, seed)
        answers, played = {}, EpisodeAnswers()
        for query_index in order:
            sent = time.perf_counter()
            answers[query_index] = self._infer(name, query_index)
            played.latencies.append(time.perf_counter() - sent)
        self._end(name)
        played.answers = [answers[query_index] for query_index in sorted(answers)]
        return played

    def retries(self, seed: int) -> tuple[list[pb.InferResponse], list[pb.InferResponse]]:
        """Plays one episode with every query sent twice. Returns the first and second answers."""
        self._reset("retried", seed)
        pairs = [
            (self._infer("retried", query_index), self._infer("retried", query_index))
            for query_index in range(QUERIES)
        ]
        self._end("retried")
        return [first for first, _ in pairs], [second for _, second in pairs]

    def interleaved(self, seed: int, other_seed: int) -> list[pb.InferResponse]:
        """Plays two episodes with alternating queries, and returns the answers of the episode of
        `seed`."""
        self._reset("first", seed)
        self._reset("second", other_seed)
        answers = []
        for query_index in range(QUERIES):
            self._infer("second", query_index)
            answers.append(self._infer("first", query_index))
        self._end("first")
        self._end("second")
        return answers

    def restarted(self, seed: int, other_seed: int) -> list[pb.InferResponse]:
        """Plays half an episode of `other_seed`, then a whole episode of `seed` under the same
        session name. Returns the answers of the second episode."""
        self._reset("restarted", other_seed)
        for query_index in range(QUERIES // 2):
            self._infer("restarted", query_index)
        return self.episode("restarted", seed).answers

    def batched(self, seed: int) -> list[pb.InferResponse]:
        """Plays as many episodes concurrently as the policy takes in a batch,
        the first with `seed`. Returns the answers of the first."""
        size = min(self.described.max_batch, MAX_BATCH_QUERIES)
        names = [f"in a batch {at}" for at in range(size)]
        for at, name in enumerate(names):
            self._reset(name, seed + at)
        answers = []
        for query_index in range(QUERIES):
            queries = [self._query(name, query_index) for name in names]
            batch = self._stub.InferBatch(pb.InferBatchRequest(queries=queries), **self._options())
            if len(batch.results) != size:
                raise CannotCheck(f"a batch of {size} came back with {len(batch.results)} results")
            for result in batch.results:
                if result.WhichOneof("result") != "response":
                    raise CannotCheck(f"a query of a batch failed: {result.error or 'empty'}")
            answers.append(batch.results[0].response)
        for name in names:
            self._end(name)
        return answers

    def unopened(self) -> Verdict:
        """Checks that a session without a Reset is refused."""
        try:
            self._infer("never opened", 0)
        except grpc.RpcError:
            return verdict.passed()
        return verdict.failed("it answers without instruction and seed")

    def ended(self, seed: int) -> Verdict:
        """Checks that the end of an episode is accepted, even twice, and that
        the server works afterwards."""
        self._reset("ended", seed)
        self._infer("ended", 0)
        for _ in range(2):
            try:
                self._stub.End(self._end_request("ended"), **self._options())
            except grpc.RpcError as error:
                if error.code() != grpc.StatusCode.UNIMPLEMENTED:
                    raise
                self.episode("after the end", seed)
                return verdict.skipped(
                    "it does not implement End, and drops idle sessions by itself"
                )
        self.episode("after the end", seed)
        return verdict.passed()

    def concurrent_episodes(self, concurrency: int) -> tuple[float, list[float]]:
        """Plays this many episodes concurrently. Returns the total time, s, and the latency of each
        query, s."""
        began = time.perf_counter()
        with ThreadPoolExecutor(concurrency) as pool:
            played = pool.map(lambda at: self.episode(f"concurrent {at}", at), range(concurrency))
            latencies = [latency for episode in played for latency in episode.latencies]
        return time.perf_counter() - began, latencies

    def _describe(self, version: int) -> pb.DescribeResponse:
        request = pb.DescribeRequest(
            protocol_version=version, policy=self._target.policy, suite=self._target.suite
        )
        return self._stub.Describe(request, **self._options())

    def _reset(self, name: str, seed: int) -> None:
        episode = fake_episode(self._target.suite)
        request = pb.ResetRequest(
            policy=self._target.policy,
            session=self._session(name),
            suite=self._target.suite,
            instruction=episode.instruction,
            seed=seed,
        )
        self._stub.Reset(request, **self._options())

    def _infer(self, name: str, query_index: int) -> pb.InferResponse:
        return self._stub.Infer(self._query(name, query_index), **self._options())

    def _end(self, name: str) -> None:
        with contextlib.suppress(grpc.RpcError):
            self._stub.End(self._end_request(name), **self._options())

    def _end_request(self, name: str) -> pb.EndRequest:
        return pb.EndRequest(policy=self._target.policy, session=self._session(name))

    def _query(self, name: str, query_index: int) -> pb.InferRequest:
        return pb.InferRequest(
            policy=self._target.policy,
            session=self._session(name),
            query_index=query_index,
            observation=self._scenes[query_index],
        )

    def _scene(self, query_index: int) -> pb.Observation:
        known_readings = {reading.value for reading in State}
        # Inputs of unknown kinds are left out; a server that needs them reports an error.
        known_inputs = Description(
            name="synthetic",
            cameras=tuple(
                Camera(camera.name, camera.width, camera.height)
                for camera in self.described.cameras
                if camera.width and camera.height
            ),
            state=tuple(
                State(number) for number in self.described.state if number in known_readings
            ),
        )
        return to_message(fake_observation(known_inputs, SCENE_SEED, query_index))

    def _session(self, name: str) -> str:
        return f"{name} in check {self._run}"

    def _options(self) -> dict[str, Any]:
        return {"timeout": ANSWER_WITHIN_SECS, "metadata": self._metadata}


def to_message(observation: Observation) -> pb.Observation:
    """Converts an observation to its message."""
    return pb.Observation(
        images=[
            pb.Image(
                camera=camera, width=frame.shape[1], height=frame.shape[0], rgb=frame.tobytes()
            )
            for camera, frame in observation.images.items()
        ],
        state=[
            pb.StateReading(field=reading.value, values=values)
            for reading, values in observation.state.items()
        ],
    )


def _connect(target: Target) -> tuple[grpc.Channel, tuple[tuple[str, str], ...]]:
    """Returns a channel and the metadata of every call. Raises CannotCheck or AccessError."""
    url = urlsplit(target.url)
    encrypted = url.scheme in ("https", "grpcs")
    if not (encrypted or url.scheme in ("http", "grpc")) or not url.netloc or url.path.strip("/"):
        raise CannotCheck(
            f"failed to read {target.url!r} as a policy server's address: write grpc://HOST:PORT,"
            " or https://HOST:PORT over TLS (openpi's servers: `policy-gateway check ws://...`)"
        )
    options = [
        ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
        ("grpc.max_send_message_length", MAX_MESSAGE_BYTES),
        ("grpc.enable_http_proxy", 0),
    ]
    token = target.tokens.for_role("operator", "worker") if target.tokens else None
    if target.tokens and token is None:
        raise CannotCheck(
            f"failed to find a token of role {' or '.join(QUERYING_ROLES)}: add a line `ROLE TOKEN`"
            " to the token file"
        )
    metadata: tuple[tuple[str, str], ...] = ()
    if token and (encrypted or is_loopback(url.hostname or "")):
        metadata = (("authorization", f"Bearer {token}"),)
    if not encrypted:
        return grpc.insecure_channel(url.netloc, options), metadata
    try:
        authority = None if target.ca is None else Path(target.ca).read_bytes()
    except OSError as error:
        raise AccessError(f"failed to read {target.ca}: {error.strerror}") from error
    credentials = grpc.ssl_channel_credentials(authority)
    return grpc.secure_channel(url.netloc, credentials, options), metadata
