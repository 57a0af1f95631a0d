"""The protocol's calls to a policy: sessions, retries, checks and errors.

A call arrives in a gRPC thread, which reads its message and prepares its frames; the policy itself
is called in the inference thread."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass, replace
from typing import Any

import grpc

from .actions import ACTION_WIDTH, UnusableActions, read_actions, read_under_way, to_simulator
from .broken import is_broken
from .description import PROTOCOL_VERSION, Description
from .episode import Episode, Observation, UnusableObservation, read_observation
from .inference import InferenceThread
from .policy import Policy
from .proto import policy_pb2 as pb
from .sessions import Session, SessionTable

#: Number of executed actions after which an episode without an opened gripper is suspicious.
GRIPPER_CHECK_ACTIONS = 50

log = logging.getLogger("rollout_policies")


@dataclass(frozen=True)
class QueryError:
    """Reason why a query got no answer. The caller knows the policy, session
    and query, so the text need not name them."""

    code: grpc.StatusCode
    text: str


class PolicyService:
    def __init__(
        self,
        policy: Policy,
        description: Description,
        inference: InferenceThread,
        sessions: SessionTable,
    ) -> None:
        self._policy = policy
        self._description = description
        self._message = description.to_message()
        self._inference = inference
        self._sessions = sessions
        self._warned_of_gripper = False

    def handler(self) -> grpc.GenericRpcHandler:
        """Returns a handler of the protocol's calls, which are methods of this class."""
        service = pb.DESCRIPTOR.services_by_name["Policy"]
        calls = {
            call.name: grpc.unary_unary_rpc_method_handler(
                getattr(self, call.name),
                request_deserializer=getattr(pb, call.input_type.name).FromString,
                response_serializer=getattr(pb, call.output_type.name).SerializeToString,
            )
            for call in service.methods
        }
        return grpc.method_handlers_generic_handler(service.full_name, calls)

    # The following methods run in gRPC threads.

    def Describe(self, request, context):
        if request.protocol_version != PROTOCOL_VERSION:
            context.abort(
                grpc.StatusCode.FAILED_PRECONDITION,
                f"the caller speaks policy protocol version {request.protocol_version}, this"
                f" server version {PROTOCOL_VERSION}; upgrade the older side",
            )
        self._require_policy(request.policy, context)
        return self._message

    def Reset(self, request, context):
        self._require_policy(request.policy, context)
        if not request.session:
            context.abort(grpc.StatusCode.INVALID_ARGUMENT, "a session needs a name")
        episode = Episode(request.session, request.suite, request.instruction, request.seed)
        problem = self._call_in_inference_thread(context, self._begin, episode)
        if problem is not None:
            context.abort(grpc.StatusCode.INTERNAL, problem)
        return pb.ResetResponse()

    def Infer(self, request, context):
        self._require_policy(request.policy, context)
        [result] = self._results([request], context)
        if isinstance(result, QueryError):
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
        results = self._results(request.queries, context)
        for result in results:
            # UNAVAILABLE means that no query is at fault. A single result holds only a text, not a
            # code, so the whole call fails.
            if isinstance(result, QueryError) and result.code == grpc.StatusCode.UNAVAILABLE:
                context.abort(result.code, result.text)
        return pb.InferBatchResponse(
            results=[
                pb.InferResult(error=result.text)
                if isinstance(result, QueryError)
                else pb.InferResult(response=result)
                for result in results
            ]
        )

    def End(self, request, context):
        self._require_policy(request.policy, context)
        session = self._sessions.close(request.session)
        if session is not None:
            # Not awaited, because queries of other episodes may be queued before it.
            self._inference.submit(self._end_episode, session)
        return pb.EndResponse()

    def _require_policy(self, name, context):
        # A worker that expects another policy must not measure this policy.
        if name not in ("", self._description.name):
            context.abort(
                grpc.StatusCode.NOT_FOUND,
                f"this server serves no policy {name!r}; it serves {self._description.name}",
            )

    def _results(self, requests, context):
        """Returns one response or QueryError per request, in the order of the requests."""
        results = [self._read(request) for request in requests]
        if any(isinstance(result, Observation) for result in results):
            return self._call_in_inference_thread(context, self._answer, results)
        return results

    def _read(self, request) -> Observation | pb.InferResponse | QueryError:
        """Returns the observation for the policy, the earlier answer to a
        retry, or the reason for refusing the query."""
        where = f"session {request.session!r}, query {request.query_index}"
        session = self._sessions.get(request.session)
        if session is None:
            return _not_open(where)
        earlier = session.answered(request.query_index)
        if earlier is not None:
            return earlier
        try:
            observation = read_observation(
                request.observation, session.episode, request.query_index, self._description
            )
            under_way = read_under_way(request, self._description)
            observation = replace(observation, under_way=under_way)
        except UnusableObservation as error:
            text = f"the observation cannot be used: {error}"
            return QueryError(grpc.StatusCode.INVALID_ARGUMENT, text)
        try:
            return replace(observation, prepared=self._policy.prepare(observation))
        except Exception as error:
            log.exception("prepare of %s failed", where)
            text = f"prepare raised {one_line(error)}"
            return QueryError(grpc.StatusCode.INTERNAL, text)

    def _call_in_inference_thread(self, context, call: Callable, *arguments: Any) -> Any:
        """Returns the result of a call in the inference thread. If the gRPC caller stops waiting
        while the call is still queued, the call is never made."""
        answer = self._inference.submit(call, *arguments)
        if not context.add_callback(answer.cancel):
            answer.cancel()
        try:
            return answer.result()
        except CancelledError:
            if not context.is_active():
                context.abort(grpc.StatusCode.CANCELLED, "the caller stopped waiting")
            context.abort(grpc.StatusCode.UNAVAILABLE, "this server is stopping")

    # The following methods run in the inference thread.

    def close_idle(self) -> None:
        """Ends episodes that have been idle for too long."""
        for session in self._sessions.close_idle():
            log.info(
                "session %r is removed: it was idle, and its caller did not end it",
                session.episode.session,
            )
            self._end_episode(session)

    def _begin(self, episode: Episode) -> str | None:
        """Starts an episode, and first ends an open episode with the same session name. Returns an
        error text, or None."""
        replaced = self._sessions.close(episode.session)
        if replaced is not None:
            self._end_episode(replaced)
        try:
            self._policy.reset(episode)
        except Exception as error:
            log.exception("reset of session %r failed", episode.session)
            return f"reset raised {one_line(error)}"
        for removed in self._sessions.open(Session(episode)):
            self._end_episode(removed)
        return None

    def _end_episode(self, session: Session) -> None:
        """Tells the policy that an episode is over, and releases its memory."""
        episode = session.episode
        if session.executed >= GRIPPER_CHECK_ACTIONS and not session.gripper_opened:
            self._warn_of_gripper(session)
        try:
            self._policy.end(episode)
        except Exception:
            log.exception("end of session %r failed", episode.session)
        episode.memory = None

    def _warn_of_gripper(self, session: Session) -> None:
        if self._warned_of_gripper:
            return
        self._warned_of_gripper = True
        log.warning(
            "policy %r never opened the gripper in session %r: none of %d actions has a negative"
            " seventh number, and -1 opens; if the model has another convention, declare it"
            " (Description(gripper=...)). Further episodes are not reported",
            self._description.name,
            session.episode.session,
            session.executed,
        )

    def _answer(self, results: list) -> list:
        """Returns the results with observations replaced by answers."""
        results = list(results)
        unanswered = []
        for at, observation in enumerate(results):
            if isinstance(observation, Observation):
                result = self._result_without_policy(observation)
                if result is None:
                    unanswered.append(at)
                else:
                    results[at] = result
        answers = self._infer([results[at] for at in unanswered])
        for at, answer in zip(unanswered, answers):
            results[at] = self._record_answer(results[at], answer)
        return results

    def _result_without_policy(
        self, observation: Observation
    ) -> pb.InferResponse | QueryError | None:
        """Returns the earlier answer to a retry, an error, or None if the policy must answer.
        `_read` made the same checks, but the session may have changed while the query waited."""
        name, query = observation.episode.session, observation.query_index
        where = f"session {name!r}, query {query}"
        session = self._sessions.get(name)
        if session is None or session.episode is not observation.episode:
            return _not_open(where)
        earlier = session.answered(query)
        if earlier is not None:
            return earlier
        if self._description.stateful and query != session.next_query:
            return QueryError(
                grpc.StatusCode.FAILED_PRECONDITION,
                f"{where}: a stateful policy answers its queries in order, and query"
                f" {session.next_query} is next",
            )
        return None

    def _infer(self, observations: Sequence[Observation]) -> list:
        """Returns the policy's answers, or its errors, in the order of the observations."""
        if len(observations) > 1:
            try:
                answers = list(self._policy.infer_batch(observations))
                if len(answers) != len(observations):
                    raise UnusableActions(
                        f"infer_batch answered {len(answers)} of {len(observations)} observations"
                    )
                return answers
            except Exception as error:
                log.exception("infer_batch of %d queries failed", len(observations))
                # The memories of a stateful policy may have advanced already.
                if self._description.stateful or is_broken(error):
                    return [error] * len(observations)
        answers = []
        for observation in observations:
            answers.append(self._infer_one(observation))
            if isinstance(answers[-1], Exception) and is_broken(answers[-1]):
                # The other queries would fail in the same way, each after some time.
                return answers + [answers[-1]] * (len(observations) - len(answers))
        return answers

    def _infer_one(self, observation: Observation) -> Any:
        try:
            return self._policy.infer(observation)
        except Exception as error:
            log.exception(
                "infer of session %r, query %d failed",
                observation.episode.session,
                observation.query_index,
            )
            return error

    def _record_answer(
        self, observation: Observation, answer: Any
    ) -> pb.InferResponse | QueryError:
        name, query = observation.episode.session, observation.query_index
        if isinstance(answer, Exception):
            return QueryError(grpc.StatusCode.INTERNAL, f"infer raised {one_line(answer)}")
        try:
            actions = read_actions(answer, self._description.horizon)
        except UnusableActions as error:
            return QueryError(grpc.StatusCode.INTERNAL, str(error))
        actions = to_simulator(actions, self._description.gripper)
        response = pb.InferResponse(actions=actions.ravel().tolist(), action_width=ACTION_WIDTH)
        session = self._sessions.get(name)
        if session is not None:
            executed = actions[: self._description.execute]
            session.executed += len(executed)
            session.gripper_opened |= bool((executed[:, -1] < 0).any())
            session.last = query, response
            session.next_query = query + 1
        return response


def _not_open(where: str) -> QueryError:
    return QueryError(
        grpc.StatusCode.UNAVAILABLE,
        f"{where}: the session is not open here (it was ended, restarted or idle for long, or"
        " the server was restarted since its Reset); start the rollout again",
    )


def one_line(error: BaseException) -> str:
    """Returns an error's type and message, shortened for a status."""
    text = f"{type(error).__name__}: {error}"
    return " ".join(text.split())[:500]
