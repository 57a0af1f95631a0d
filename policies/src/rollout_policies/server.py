"""The server around a policy: sessions, retries, turns and errors."""

from __future__ import annotations

import logging
import signal
import threading
from collections import OrderedDict
from concurrent import futures
from dataclasses import dataclass

import grpc

from . import health
from .description import PROTOCOL_VERSION
from .episode import Episode, Observation, UnusableObservation, read_observation
from .policy import ACTION_WIDTH, Policy, UnusableActions, read_actions
from .proto import policy_pb2 as pb
from .proto import policy_pb2_grpc as pb_grpc

#: Episodes remembered; the one idle for longest is forgotten first.
MAX_SESSIONS = 1024
#: Requests that may wait for their turn; more are refused.
MAX_CONCURRENT_RPCS = 256
#: Largest message, bytes: as in the gateway and the worker.
MAX_MESSAGE_BYTES = 32 << 20
#: How long requests under way may take after the signal to stop.
SHUTDOWN_GRACE_SECS = 10.0

log = logging.getLogger("rollout_policies")


class Server:
    """A running server."""

    def __init__(self, server: grpc.Server, address: str) -> None:
        self._server = server
        #: host:port, with the real port.
        self.address = address

    def stop(self, grace_secs: float = SHUTDOWN_GRACE_SECS) -> None:
        """Lets requests under way finish, then frees the port."""
        self._server.stop(grace_secs).wait()

    def wait(self) -> None:
        """Returns when the server has stopped."""
        self._server.wait_for_termination()


def start(policy: Policy, listen: str = "127.0.0.1:0") -> Server:
    """Serves a policy in the background. Port 0 takes a free one."""
    server = grpc.server(
        futures.ThreadPoolExecutor(max_workers=MAX_CONCURRENT_RPCS),
        maximum_concurrent_rpcs=MAX_CONCURRENT_RPCS,
        options=[
            ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
            ("grpc.max_send_message_length", MAX_MESSAGE_BYTES),
            # Else a second server on the same port would share its requests.
            ("grpc.so_reuseport", 0),
        ],
    )
    pb_grpc.add_PolicyServicer_to_server(_Service(policy), server)
    server.add_generic_rpc_handlers((health.handler(),))
    try:
        port = server.add_insecure_port(listen)
    except RuntimeError as error:
        raise OSError(f"failed to listen on {listen}: {error}") from error
    if port == 0:
        raise OSError(f"failed to listen on {listen}: is the port taken?")
    server.start()
    return Server(server, f"{listen.rpartition(':')[0]}:{port}")


def serve(policy: Policy, listen: str = "127.0.0.1:0") -> None:
    """Serves a policy until SIGTERM or SIGINT; prints one line, the address."""
    server = start(policy, listen)
    print(f"listening on {server.address}", flush=True)
    stopping = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    stopping.wait()
    server.stop()


@dataclass
class _Session:
    episode: Episode
    next_query: int = 0
    last_query: int | None = None
    last_answer: pb.InferResponse | None = None


@dataclass(frozen=True)
class _QueryError:
    """Why one query got no answer, in a text that names it."""

    code: grpc.StatusCode
    text: str


class _Service(pb_grpc.PolicyServicer):
    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        self._description = policy.description
        self._sessions: OrderedDict[str, _Session] = OrderedDict()
        # Guards sessions and policy alike.
        self._turn = threading.Lock()

    def Describe(self, request, context):
        if request.protocol_version != PROTOCOL_VERSION:
            context.abort(
                grpc.StatusCode.FAILED_PRECONDITION,
                f"the caller speaks policy protocol version {request.protocol_version}, this"
                f" server version {PROTOCOL_VERSION}; upgrade the older side",
            )
        self._require_policy(request.policy, context)
        return self._description.to_message()

    def Reset(self, request, context):
        self._require_policy(request.policy, context)
        if not request.session:
            context.abort(grpc.StatusCode.INVALID_ARGUMENT, "a session needs a name")
        episode = Episode(request.session, request.suite, request.instruction, request.seed)
        with self._turn:
            try:
                self._policy.reset(episode)
            except Exception as error:
                log.exception("reset of session %r failed", request.session)
                text = f"reset of session {request.session!r} raised {_one_line(error)}"
                context.abort(grpc.StatusCode.INTERNAL, text)
            self._sessions[request.session] = _Session(episode)
            self._sessions.move_to_end(request.session)
            while len(self._sessions) > MAX_SESSIONS:
                self._sessions.popitem(last=False)
        return pb.ResetResponse()

    def Infer(self, request, context):
        self._require_policy(request.policy, context)
        with self._turn:
            result = self._answer([request])[0]
        if isinstance(result, _QueryError):
            context.abort(result.code, result.text)
        return result

    def InferBatch(self, request, context):
        largest = max(1, self._description.max_batch)
        if len(request.queries) > largest:
            context.abort(
                grpc.StatusCode.INVALID_ARGUMENT,
                f"{len(request.queries)} queries in one InferBatch; at most {largest} are taken",
            )
        for query in request.queries:
            self._require_policy(query.policy, context)
        with self._turn:
            results = self._answer(request.queries)
        for result in results:
            # The text of one result could not say that nobody is to blame.
            if isinstance(result, _QueryError) and result.code == grpc.StatusCode.UNAVAILABLE:
                context.abort(result.code, result.text)
        return pb.InferBatchResponse(
            results=[
                pb.InferResult(error=result.text)
                if isinstance(result, _QueryError)
                else pb.InferResult(response=result)
                for result in results
            ]
        )

    def _require_policy(self, name, context):
        # A worker that means another policy must not measure this one.
        if name not in ("", self._description.name):
            context.abort(
                grpc.StatusCode.NOT_FOUND,
                f"this server serves no policy {name!r}; it serves {self._description.name}",
            )

    def _answer(self, requests):
        """One response or _QueryError per request, in their order."""
        results = [self._prepare(request) for request in requests]
        asked = [at for at, result in enumerate(results) if isinstance(result, Observation)]
        answers = self._infer([results[at] for at in asked])
        for at, answer in zip(asked, answers):
            results[at] = self._keep(results[at], answer)
        return results

    def _prepare(self, request):
        """What to ask the policy; or the answer that it gave before; or why
        it cannot be asked."""
        where = f"session {request.session!r}, query {request.query_index}"
        session = self._sessions.get(request.session)
        if session is None:
            return _QueryError(
                grpc.StatusCode.UNAVAILABLE,
                f"{where}: the session is not open here (the server may have restarted since"
                " its Reset); start the rollout again",
            )
        self._sessions.move_to_end(request.session)
        if session.last_query == request.query_index:
            return session.last_answer
        if self._description.stateful and request.query_index != session.next_query:
            return _QueryError(
                grpc.StatusCode.FAILED_PRECONDITION,
                f"{where}: a stateful policy answers its queries in order, and query"
                f" {session.next_query} is next",
            )
        try:
            return read_observation(
                request.observation, session.episode, request.query_index, self._description
            )
        except UnusableObservation as error:
            text = f"{where}: unusable observation: {error}"
            return _QueryError(grpc.StatusCode.INVALID_ARGUMENT, text)

    def _infer(self, observations):
        """The policy's answers, or what it raised, in their order."""
        if len(observations) > 1:
            try:
                answers = list(self._policy.infer_batch(observations))
                if len(answers) != len(observations):
                    raise UnusableActions(
                        f"infer_batch answered {len(answers)} of {len(observations)} observations"
                    )
                return answers
            except Exception as error:
                log.exception("infer_batch failed")
                return [error] * len(observations)
        return [self._infer_one(observation) for observation in observations]

    def _infer_one(self, observation):
        try:
            return self._policy.infer(observation)
        except Exception as error:
            log.exception(
                "infer of session %r, query %d failed",
                observation.episode.session,
                observation.query_index,
            )
            return error

    def _keep(self, observation, answer):
        session = self._sessions[observation.episode.session]
        where = (
            f"policy {self._description.name!r}, session {observation.episode.session!r},"
            f" query {observation.query_index}"
        )
        if isinstance(answer, Exception):
            return _QueryError(
                grpc.StatusCode.INTERNAL, f"{where}: infer raised {_one_line(answer)}"
            )
        try:
            actions = read_actions(answer, self._description.horizon)
        except UnusableActions as error:
            return _QueryError(grpc.StatusCode.INTERNAL, f"{where}: {error}")
        response = pb.InferResponse(actions=actions.ravel().tolist(), action_width=ACTION_WIDTH)
        session.last_query = observation.query_index
        session.last_answer = response
        session.next_query = observation.query_index + 1
        return response


def _one_line(error: BaseException) -> str:
    """Type and message, short enough for a status."""
    text = f"{type(error).__name__}: {error}"
    return " ".join(text.split())[:500]
