"""The thread that calls a policy, the order of its calls, and its warm-up."""

import logging
import pathlib
import sys
import threading
import time
from concurrent.futures import CancelledError, ThreadPoolExecutor

import numpy as np
import pytest
from conftest import Client, Plain, running
from test_conformance import adapters_with_computed_networks

from rollout_policies import Description, Policy, UnusableActions, fake_observation
from rollout_policies.adapters import openvla_oft
from rollout_policies.fake import to_message
from rollout_policies.inference import InferenceThread
from rollout_policies.proto import policy_pb2 as pb

THREADS = pathlib.Path(__file__).parent / "threads.py"
#: Longest wait of a test before it fails, s.
TIMEOUT = 60


def test_one_thread_creates_warms_up_and_queries_a_policy(tmp_path):
    notes = tmp_path / "notes"
    with running(sys.executable, str(THREADS), "--notes", str(notes)) as (_, address):
        assert [line.split()[0] for line in notes.read_text().splitlines()] == [
            "__init__",
            "warm_up",
        ]
        client = Client(address)
        with ThreadPoolExecutor(8) as pool:
            sessions = [f"s{at}" for at in range(8)]
            list(pool.map(client.reset, sessions))
            list(pool.map(client.infer, sessions))
            queries = [client.request(session, 1) for session in sessions[:2]]
            client.stub.InferBatch(pb.InferBatchRequest(queries=queries))
            list(pool.map(client.end, sessions))
        # This reset is queued after the ends, which are not awaited.
        client.reset("last")
        client.channel.close()
    threads = {}
    for line in notes.read_text().splitlines():
        method, thread = line.split()
        threads.setdefault(method, set()).add(thread)
    model_threads = [threads[name] for name in threads if name != "prepare"]
    assert set(threads) == {
        "__init__",
        "warm_up",
        "reset",
        "infer",
        "infer_batch",
        "end",
        "prepare",
    }
    assert model_threads == [model_threads[0]] * len(model_threads) and len(model_threads[0]) == 1
    assert threads["prepare"].isdisjoint(model_threads[0])


def test_frames_are_prepared_while_the_model_answers_other_queries(serving):
    class Waiting(Plain):
        description = Description(name="waiting")

        def __init__(self):
            self.other_is_prepared = threading.Event()

        def prepare(self, observation):
            if observation.episode.session == "b":
                self.other_is_prepared.set()
            return observation.episode.session

        def infer(self, observation):
            assert self.other_is_prepared.wait(TIMEOUT), "prepare waits for its turn"
            assert observation.prepared == observation.episode.session
            return np.zeros(7)

    client = serving(Waiting())
    client.reset("a")
    client.reset("b")
    with ThreadPoolExecutor(2) as pool:
        assert [answer.shape for answer in pool.map(client.infer, "ab")] == [(1, 7), (1, 7)]


def test_an_exception_in_prepare_fails_its_query_only(serving):
    class FailingPrepare(Plain):
        description = Description(name="picky", max_batch=2)

        def prepare(self, observation):
            if observation.episode.session == "bad":
                raise ValueError("no such frame")

    client = serving(FailingPrepare())
    client.reset("bad")
    client.reset("good")
    queries = [client.request("bad"), client.request("good")]
    bad, good = client.stub.InferBatch(pb.InferBatchRequest(queries=queries)).results
    assert bad.error == "prepare raised ValueError: no such frame"
    assert len(good.response.actions) == 7


def test_a_query_cancelled_by_its_caller_is_not_computed(serving, monkeypatch):
    class Slow(Plain):
        description = Description(name="slow", max_batch=2)

        def __init__(self):
            self.sessions, self.begun, self.release = [], threading.Event(), threading.Event()

        def infer(self, observation):
            self.sessions.append(observation.episode.session)
            self.begun.set()
            assert self.release.wait(TIMEOUT)
            return np.zeros(7)

    calls, submit = [], InferenceThread.submit

    def recording_submit(*arguments):
        calls.append(submit(*arguments))
        return calls[-1]

    policy = Slow()
    client = serving(policy)
    for session in "abc":
        client.reset(session)
    monkeypatch.setattr(InferenceThread, "submit", recording_submit)

    def submitted(method, message):
        """Returns a call that has reached its server, and the server's future for it."""
        before = len(calls)
        call = method.future(message)
        until(lambda: len(calls) > before)
        return call, calls[-1]

    first, _ = submitted(client.stub.Infer, client.request("a"))
    assert policy.begun.wait(TIMEOUT)
    alone = submitted(client.stub.Infer, client.request("b"))
    queries = [client.request("b"), client.request("c")]
    batch = submitted(client.stub.InferBatch, pb.InferBatchRequest(queries=queries))
    last_call, _ = submitted(client.stub.Infer, client.request("c"))
    for call, server_future in (alone, batch):
        call.cancel()
        until(server_future.cancelled)
    policy.release.set()
    assert len(first.result(TIMEOUT).actions) == len(last_call.result(TIMEOUT).actions) == 7
    assert policy.sessions == ["a", "c"]


def until(is_true):
    """Waits until a condition holds."""
    deadline = time.monotonic() + TIMEOUT
    while not is_true():
        assert time.monotonic() < deadline, "the condition does not hold in time"
        time.sleep(0.005)


def test_calls_are_made_in_order_and_queued_calls_are_cancelled_at_the_end():
    inference = InferenceThread()
    executed, swept, release = [], threading.Event(), threading.Event()
    thread = threading.Thread(target=inference.work, args=(swept.set, 0.01), daemon=True)
    calls = [inference.submit(executed.append, at) for at in range(5)]
    failing = inference.submit(lambda: 1 / 0)
    thread.start()
    assert isinstance(failing.exception(TIMEOUT), ZeroDivisionError)
    assert executed == [0, 1, 2, 3, 4] and all(call.done() for call in calls)
    assert swept.wait(TIMEOUT)
    under_way = threading.Event()
    first = inference.submit(lambda: (under_way.set(), release.wait(TIMEOUT)))
    waiting = inference.submit(executed.append, "too late")
    assert under_way.wait(TIMEOUT)
    inference.close()
    release.set()
    thread.join(TIMEOUT)
    assert first.result()[1] is True
    for late in (waiting, inference.submit(executed.append, "later still")):
        with pytest.raises(CancelledError):
            late.result(TIMEOUT)
    assert "too late" not in executed


def test_idle_episodes_are_closed_although_calls_keep_arriving():
    inference, swept = InferenceThread(), threading.Event()
    deadline = time.monotonic() + TIMEOUT

    def resubmit():
        if swept.is_set() or time.monotonic() > deadline:
            inference.close()
        else:
            inference.submit(resubmit)

    inference.submit(resubmit)
    inference.work(swept.set, 0.01)
    assert swept.is_set()


def test_running_queries_are_answered_before_a_server_stops(tmp_path):
    script = tmp_path / "slow_policy.py"
    script.write_text(
        "import pathlib, sys, time\n"
        "import numpy as np\n"
        "from rollout_policies import Description, Policy, run\n"
        "class Slow(Policy):\n"
        "    description = Description(name='slow')\n"
        "    def __init__(self, go: pathlib.Path):\n"
        "        self.go = go\n"
        "    def reset(self, episode):\n"
        "        self.waits = episode.session == 's'\n"
        "    def infer(self, observation):\n"
        "        if self.waits:\n"
        "            self.go.with_suffix('.queried').touch()\n"
        "        while self.waits and not self.go.exists():\n"
        "            time.sleep(0.01)\n"
        "        return np.zeros(7)\n"
        "run(Slow)\n"
    )
    go = tmp_path / "go"
    with running(sys.executable, str(script), "--go", str(go)) as (process, address):
        client = Client(address)
        client.reset()
        answer = client.stub.Infer.future(client.request(), timeout=TIMEOUT)
        while not go.with_suffix(".queried").exists():
            assert process.poll() is None
            time.sleep(0.01)
        process.terminate()
        go.touch()
        assert len(answer.result().actions) == 7
        assert process.wait(TIMEOUT) == 0
        client.channel.close()


class WarmedUp(Policy):
    """Accepts tasks of one suite, and records the sizes of its batches."""

    def __init__(self, answer, max_batch=1):
        self.description = Description(name="warmed-up", horizon=2, max_batch=max_batch)
        self.answer, self.sizes, self.open = answer, [], set()

    def reset(self, episode):
        if episode.suite != "libero_goal":
            raise ValueError("these weights are for libero_goal")
        self.open.add(episode.session)

    def infer(self, observation):
        return self.infer_batch([observation])[0]

    def infer_batch(self, observations):
        self.sizes.append(len(observations))
        if isinstance(self.answer, Exception):
            raise self.answer
        return [self.answer] * len(observations)

    def end(self, episode):
        self.open.remove(episode.session)


@pytest.mark.parametrize(("max_batch", "sizes"), [(1, [1]), (4, [1, 4])])
def test_the_warm_up_sends_one_query_and_a_full_batch_of_an_accepted_suite(max_batch, sizes):
    policy = WarmedUp(np.zeros(7), max_batch)
    policy.warm_up()
    assert policy.sizes == sizes and policy.open == set()


@pytest.mark.parametrize(
    ("answer", "expected"),
    [(RuntimeError("no kernel"), "no kernel"), (np.zeros((3, 7)), "its horizon is 2")],
)
def test_a_policy_without_valid_answers_fails_in_the_warm_up(answer, expected):
    policy = WarmedUp(answer)
    with pytest.raises((RuntimeError, UnusableActions), match=expected):
        policy.warm_up()
    assert policy.open == set()


def test_a_policy_that_refuses_all_synthetic_episodes_is_served_without_warm_up(caplog):
    class RefusingAllSuites(WarmedUp):
        def reset(self, episode):
            raise ValueError("another robot's tasks")

    policy = RefusingAllSuites(np.zeros(7))
    with caplog.at_level(logging.WARNING):
        policy.warm_up()
    assert policy.sizes == []
    assert "not warmed up" in caplog.text and "another robot's tasks" in caplog.text


@pytest.mark.parametrize("name", ["openvla-oft", "univla"])
def test_jpeg_round_trips_run_outside_the_inference_thread(serving, monkeypatch, name):
    policies = adapters_with_computed_networks()
    policy, *_ = [policy for policy in policies if policy.description.name == name]
    preparing_threads = []

    def frame(turned):
        preparing_threads.append(threading.current_thread().name)
        return turned

    monkeypatch.setattr(openvla_oft, "frame", frame)
    monkeypatch.setattr(policy, "frame", frame, raising=False)
    client = serving(policy)
    client.reset(suite="libero_object", instruction="pick up the butter")
    client.infer(observation=to_message(fake_observation(policy.description)))
    assert len(preparing_threads) == len(policy.description.cameras)
    assert "inference" not in preparing_threads
