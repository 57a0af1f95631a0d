"""Errors and the end of the processes of `SubprocVectorEnv`."""

import multiprocessing
import signal
from collections.abc import Iterator
from typing import Any

import pytest
import stubs

from libero.libero.envs import DummyVectorEnv, SubprocVectorEnv

pytestmark = pytest.mark.usefixtures("deadline")


@pytest.fixture
def deadline() -> Iterator[None]:
    """Fails a test that waits for an answer that never comes."""

    def fail(*_: Any) -> None:
        pytest.fail("no answer within 20 s")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(20)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def assert_ended(envs: SubprocVectorEnv) -> None:
    for worker in envs.workers:
        worker.process.join(timeout=5)
        assert not worker.process.is_alive()


@pytest.mark.parametrize(
    ("action", "error", "message"),
    [
        (stubs.collide, RuntimeError, "^Collision: cup touches plate$"),
        (stubs.raise_local, RuntimeError, "^Local: only here$"),
        (stubs.observe_collision, TypeError, "other"),
        (stubs.observe_function, Exception, "observe_function"),
    ],
)
def test_environments_continue_after_an_answer_that_cannot_be_sent(
    action: Any, error: type[Exception], message: str
) -> None:
    envs = SubprocVectorEnv([stubs.Stub] * 2)
    with pytest.raises(error, match=message):
        envs.step([action, stubs.idle])
    *_, infos = envs.step([stubs.idle] * 2)
    assert [info["steps"] for info in infos] == [2, 2]
    envs.close()
    assert_ended(envs)


def test_an_error_that_is_sent_as_text_has_the_traceback_of_its_process() -> None:
    envs = SubprocVectorEnv([stubs.Stub])
    with pytest.raises(RuntimeError) as caught:
        envs.step([stubs.collide])
    assert "in collide" in str(caught.value.__cause__)
    envs.close()


def test_a_construction_error_that_cannot_be_sent_arrives_as_text() -> None:
    envs = SubprocVectorEnv([stubs.colliding])
    with pytest.raises(RuntimeError, match="^Collision: cup touches plate$"):
        envs.reset()
    with pytest.raises(RuntimeError, match="process has ended .exit code 0.: make new"):
        envs.reset()
    envs.close()


def test_an_interrupted_construction_does_not_shift_answers() -> None:
    envs = SubprocVectorEnv([stubs.slow])
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_REAL, 0.1)
    with pytest.raises(KeyboardInterrupt):
        envs.reset()
    signal.signal(signal.SIGALRM, before)
    signal.alarm(20)
    assert envs.get_env_attr("steps") == [0]
    envs.close()


def test_environments_close_after_an_interrupt() -> None:
    envs = SubprocVectorEnv([stubs.Stub] * 3)
    envs.reset()
    # Like Ctrl-C during a step, this ends some processes while their answers are awaited.
    for worker in envs.workers[:2]:
        worker.send(stubs.interrupt)
        worker.process.join()
    with pytest.raises(RuntimeError, match="process has ended .exit code -2.: make new"):
        envs.reset()
    envs.close()
    assert envs.is_closed
    assert_ended(envs)


def test_an_ended_process_is_named_at_the_next_command() -> None:
    envs = SubprocVectorEnv([stubs.Stub])
    envs.reset()
    envs.workers[0].process.kill()
    envs.workers[0].process.join()
    with pytest.raises(RuntimeError, match="process has ended .exit code -9.: make new"):
        envs.reset()
    envs.close()


@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
def test_observations_outlive_the_next_step(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multiprocessing, "Process", multiprocessing.get_context(method).Process)
    envs = SubprocVectorEnv([stubs.Stub] * 2)
    frames = [envs.step([stubs.frame, stubs.idle])[0][0] for _ in range(2)]
    assert frames[0].shape == frames[1].shape == (256, 256, 3)
    assert frames[0].flags.writeable and (frames[0] != frames[1]).any()
    envs.close()
    assert_ended(envs)


@pytest.mark.parametrize("construct", [stubs.invalid, stubs.colliding, stubs.Unclosable])
def test_environments_close_if_another_environment_fails(construct: Any) -> None:
    envs = SubprocVectorEnv([construct, stubs.Stub])
    envs.close()
    assert envs.is_closed
    assert_ended(envs)


def test_environments_of_one_process_close_before_an_error_is_raised() -> None:
    envs = DummyVectorEnv([stubs.Unclosable, stubs.Stub])
    with pytest.raises(ValueError, match="stays open"):
        envs.close()
    assert envs.is_closed
    assert all(worker.is_closed for worker in envs.workers)
