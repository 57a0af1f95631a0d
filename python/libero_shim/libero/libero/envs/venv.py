"""Several environments behind one interface: one after another, or each in a process.

Each environment of `SubprocVectorEnv` has its own NumPy global generator, as LIBERO's users expect.
`rollout_libero.VectorEnvironment` needs less memory and time."""

from __future__ import annotations

import ctypes
import multiprocessing
import pickle
import traceback
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from multiprocessing import reduction
from multiprocessing.sharedctypes import RawArray
from typing import Any

import cloudpickle
import numpy as np
from numpy.typing import NDArray

__all__ = [
    "BaseVectorEnv", "CloudpickleWrapper", "DummyEnvWorker", "DummyVectorEnv", "EnvWorker",
    "ShArray", "SubprocEnvWorker", "SubprocVectorEnv",
]  # fmt: skip

#: Attributes that are lists over the environments.
GYM_RESERVED_KEYS = ["metadata", "reward_range", "spec", "action_space", "observation_space"]

_Ids = int | Sequence[int] | NDArray[np.integer] | None


def deprecation(msg: str) -> None:
    """Warns of a deprecated feature."""
    warnings.warn(msg, DeprecationWarning, stacklevel=2)


class ShArray:
    """An array in memory shared by processes."""

    def __init__(self, dtype: Any, shape: Sequence[int]) -> None:
        self.dtype = np.dtype(dtype)
        self.shape = tuple(shape)
        size = int(np.prod(self.shape)) * self.dtype.itemsize
        self.arr = RawArray(ctypes.c_ubyte, size)

    def save(self, ndarray: NDArray[Any]) -> None:
        """Copies an array of the same shape into it."""
        if np.shape(ndarray) != self.shape:
            raise ValueError(
                f"the shared array has shape {self.shape}, not {np.shape(ndarray)}: give an array "
                "of its space"
            )
        np.copyto(self.get(), ndarray, casting="unsafe")

    def get(self) -> NDArray[Any]:
        """Returns the array, which the next `save` overwrites."""
        return np.frombuffer(self.arr, dtype=self.dtype).reshape(self.shape)


def _setup_buf(space: Any) -> Any:
    """Returns shared arrays for a space of gym or gymnasium."""
    parts = getattr(space, "spaces", None)
    if isinstance(parts, Mapping):
        return {name: _setup_buf(part) for name, part in parts.items()}
    if parts is not None:
        return tuple(_setup_buf(part) for part in parts)
    return ShArray(space.dtype, space.shape)


class CloudpickleWrapper:
    """Wrapper that sends any object to a process, also a lambda or closure."""

    def __init__(self, data: Any) -> None:
        self.data = data

    def __getstate__(self) -> bytes:
        return bytes(cloudpickle.dumps(self.data))

    def __setstate__(self, data: bytes) -> None:
        self.data = pickle.loads(data)


class EnvWorker(ABC):
    """One of several environments. `send` starts a step or, without an action, a reset; `recv`
    returns its result."""

    def __init__(self, env_fn: Callable[[], Any]) -> None:
        self._env_fn = env_fn
        self.is_closed = False

    @abstractmethod
    def call(self, method: str, *arguments: Any) -> Any:
        """Calls a method of the environment."""

    @abstractmethod
    def send(self, action: Any, **kwargs: Any) -> None:
        """Begins a step, or a reset if there is no action."""

    @abstractmethod
    def recv(self) -> Any:
        """Returns the result of the step or reset."""

    def begin(self, method: str, *arguments: Any) -> None:
        """Starts a method call; `recv` returns its result."""
        raise NotImplementedError(f"{type(self).__name__} makes no concurrent method calls")

    @abstractmethod
    def get_env_attr(self, key: str) -> Any:
        """Returns an attribute of the environment; None if it does not exist."""

    @abstractmethod
    def set_env_attr(self, key: str, value: Any) -> None:
        """Sets an attribute of the environment."""

    @abstractmethod
    def close_env(self) -> None:
        """Closes the environment."""

    def close(self) -> None:
        if not self.is_closed:
            self.is_closed = True
            self.close_env()

    def reset(self, **kwargs: Any) -> Any:
        self.send(None, **kwargs)
        return self.recv()

    def step(self, action: Any) -> Any:
        self.send(action)
        return self.recv()

    def seed(self, seed: int | None = None) -> Any:
        return self.call("seed", seed)

    def render(self, **kwargs: Any) -> Any:
        """Returns the environment's picture; None if it makes none."""
        return self.call("render", kwargs)

    @staticmethod
    def wait(conns: Any, wait_num: int, timeout: float | None = None) -> list[Any]:
        """Returns all of these workers, because a step waits for all of them."""
        return list(conns)

    def check_success(self) -> bool:
        return bool(self.call("check_success"))

    def get_segmentation_of_interest(self, segmentation_image: Any) -> Any:
        """See `SegmentationRenderEnv`."""
        return self.call("get_segmentation_of_interest", segmentation_image)

    def get_sim_state(self) -> Any:
        """The state: time, positions and velocities."""
        return self.call("get_sim_state")

    def set_init_state(self, init_state: Any) -> Any:
        return self.call("set_init_state", init_state)


class DummyEnvWorker(EnvWorker):
    """An environment in this process."""

    def __init__(self, env_fn: Callable[[], Any]) -> None:
        self.env = env_fn()
        self.result: Any = None
        super().__init__(env_fn)

    def call(self, method: str, *arguments: Any) -> Any:
        return getattr(self.env, method)(*arguments)

    def begin(self, method: str, *arguments: Any) -> None:
        self.result = self.call(method, *arguments)

    def send(self, action: Any, **kwargs: Any) -> None:
        self.result = self.env.reset(**kwargs) if action is None else self.env.step(action)

    def recv(self) -> Any:
        return self.result

    def render(self, **kwargs: Any) -> Any:
        return _picture(self.env, kwargs)

    def get_env_attr(self, key: str) -> Any:
        return getattr(self.env, key, None)

    def set_env_attr(self, key: str, value: Any) -> None:
        setattr(self.env, key, value)

    def close_env(self) -> None:
        self.env.close()


def _picture(env: Any, kwargs: dict[str, Any]) -> Any:
    return env.render(**kwargs) if hasattr(env, "render") else None


class _Failure:
    """An exception sent from a process to its parent."""

    def __init__(self, error: Exception) -> None:
        self.trace = traceback.format_exc()
        self.error = _sendable(error)

    def reraise(self) -> None:
        raise self.error from RuntimeError(f"in the environment's process:\n{self.trace}")


def _sendable(error: Exception) -> Exception:
    """Returns the error, or a RuntimeError with its text if it cannot be pickled and unpickled.
    Unpickling fails for an exception whose constructor takes other arguments than its `args`."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def _serve(parent: Any, connection: Any, env_fn: CloudpickleWrapper, obs_bufs: None = None) -> None:
    """Runs an environment: answers messages `[command, data]` until the command `close`. `obs_bufs`
    is not used; it keeps the position that it has in LIBERO's function."""
    parent.close()
    try:
        env = env_fn.data()
    except Exception as error:  # noqa: BLE001
        connection.send(_Failure(error))
        return
    connection.send(None)
    dumps = reduction.ForkingPickler.dumps
    commands: dict[str, Callable[[Any], Any]] = {
        "reset": lambda kwargs: env.reset(**kwargs),
        "render": lambda kwargs: _picture(env, kwargs),
        "getattr": lambda key: getattr(env, key, None),
        "setattr": lambda pair: setattr(env, pair["key"], pair["value"]),
        "check_success": lambda _: env.check_success(),
        "get_sim_state": lambda _: env.get_sim_state(),
        "close": lambda _: env.close(),
    }
    while True:
        try:
            command, data = connection.recv()
        except (EOFError, KeyboardInterrupt):
            return
        try:
            message = dumps((commands.get(command) or getattr(env, command))(data))
        except Exception as error:  # noqa: BLE001
            message = dumps(_Failure(error))
        connection.send_bytes(message)
        if command == "close":
            return


#: The name that other projects import.
_worker = _serve


class SubprocEnvWorker(EnvWorker):
    """An environment in a separate process, started by `multiprocessing`'s start method."""

    # The defaults hold for a subclass that starts its own process, with its own loop of commands.
    _is_starting = False
    _is_awaited = False

    def __init__(self, env_fn: Callable[[], Any], share_memory: bool = False) -> None:
        if share_memory:
            raise NotImplementedError(
                "frames are sent through a pipe: leave share_memory at False, or use "
                "rollout_libero.VectorEnvironment, which sends none"
            )
        self.parent_remote, self.child_remote = multiprocessing.Pipe()
        self.share_memory = share_memory
        self.process = multiprocessing.Process(
            target=_serve,
            args=(self.parent_remote, self.child_remote, CloudpickleWrapper(env_fn)),
            daemon=True,
        )
        self.process.start()
        self.child_remote.close()
        self._is_starting = True
        super().__init__(env_fn)

    def begin(self, method: str, *arguments: Any) -> None:
        self._send(method, arguments[0] if arguments else None)

    def call(self, method: str, *arguments: Any) -> Any:
        self.begin(method, *arguments)
        return self.recv()

    def send(self, action: Any, **kwargs: Any) -> None:
        if action is None:
            self._send("reset", kwargs)
        else:
            self._send("step", action)

    def recv(self) -> Any:
        answer = pickle.loads(self._receive())
        if isinstance(answer, _Failure):
            answer.reraise()
        return answer

    def get_env_attr(self, key: str) -> Any:
        return self.call("getattr", key)

    def set_env_attr(self, key: str, value: Any) -> None:
        self.call("setattr", {"key": key, "value": value})

    def close_env(self) -> None:
        try:
            self.call("close")
            self.process.join()
        except Exception:  # noqa: BLE001
            # If the environment failed or its process has ended, nothing is left to close.
            pass
        finally:
            self.process.terminate()

    def _send(self, command: str, data: Any) -> None:
        # Environments are created concurrently: each is awaited only at its first command.
        if self._is_starting:
            self.recv()
        if self._is_awaited:
            # Drops the answer to a command that Ctrl-C interrupted.
            self._receive()
        try:
            self.parent_remote.send([command, data])
        except ConnectionError as error:
            raise self._ended() from error
        self._is_awaited = True

    def _receive(self) -> bytes:
        """Returns the process's next message. The message is no longer awaited from then on, even
        if it cannot be unpickled."""
        try:
            message: bytes = self.parent_remote.recv_bytes()
        except (EOFError, ConnectionError) as error:
            raise self._ended() from error
        self._is_starting = self._is_awaited = False
        return message

    def _ended(self) -> RuntimeError:
        self.process.join(timeout=1)
        return RuntimeError(
            "the environment's process has ended "
            f"(exit code {self.process.exitcode}): make new environments"
        )


class BaseVectorEnv:
    """Several environments. `id` selects some of them: a number, a list, or None for all."""

    def __init__(
        self,
        env_fns: Sequence[Callable[[], Any]],
        worker_fn: Callable[[Callable[[], Any]], Any],
        wait_num: int | None = None,
        timeout: float | None = None,
    ) -> None:
        if wait_num not in (None, len(env_fns)) or timeout is not None:
            raise NotImplementedError(
                "a step waits for all its environments: leave wait_num and timeout out, and "
                "step some environments at a time with `id`"
            )
        self._env_fns = env_fns
        self.workers = [worker_fn(env_fn) for env_fn in env_fns]
        self.worker_class = type(self.workers[0]) if self.workers else EnvWorker
        self.env_num = len(env_fns)
        self.wait_num = self.env_num
        self.timeout = timeout
        self.is_async = False
        self.waiting_conn: list[Any] = []
        self.is_closed = False
        self.waiting_id: list[int] = []
        self.ready_id = list(range(self.env_num))

    def __len__(self) -> int:
        return self.env_num

    def __getattr__(self, name: str) -> Any:
        if name in GYM_RESERVED_KEYS:
            return self.get_env_attr(name)
        raise AttributeError(
            f"{type(self).__name__} has no `{name}`: get each environment's with get_env_attr"
        )

    def reset(self, id: _Ids = None, **kwargs: Any) -> Any:
        """Resets environments. Returns their observations in an array [n] of objects, and a list of
        their infos if they return infos, as gymnasium's environments do."""
        chosen = self._choose(id)
        results = self._exchange(chosen, lambda worker, _: worker.send(None, **kwargs))
        if results and all(map(_has_info, results)):
            observations, infos = zip(*results)
            return _stack(observations), list(infos)
        return _stack(results)

    def step(self, action: Any, id: _Ids = None) -> tuple[Any, ...]:
        """Executes one control step of each environment, with actions [n, 7]. Returns observations,
        rewards, dones and infos, [n] each; an info's `env_id` identifies its environment."""
        chosen = self._choose(id)
        if len(action) != len(chosen):
            raise ValueError(
                f"{len(chosen)} environments were given {len(action)} actions: give one each"
            )
        results = self._exchange(chosen, lambda worker, at: worker.send(action[at]))
        for i, result in zip(chosen, results):
            result[-1]["env_id"] = i
        observations, *others = zip(*results)
        return (_stack(observations), *map(np.stack, others))

    def render(self, **kwargs: Any) -> list[Any]:
        """Returns each environment's picture; None if it makes none."""
        self._assert_is_not_closed()
        return [worker.render(**kwargs) for worker in self.workers]

    def seed(self, seed: int | Sequence[int | None] | None = None) -> list[Any]:
        """Seeds all environments: from a list, or with consecutive seeds that begin at a number."""
        self._assert_is_not_closed()
        if seed is None or isinstance(seed, (int, np.integer)):
            seed = [None if seed is None else seed + i for i in range(self.env_num)]
        return [worker.seed(number) for worker, number in zip(self.workers, seed)]

    def check_success(self) -> list[bool]:
        """Returns for each environment True if its goal holds."""
        self._assert_is_not_closed()
        return [worker.check_success() for worker in self.workers]

    def get_sim_state(self) -> list[Any]:
        """Each environment's state."""
        self._assert_is_not_closed()
        return [worker.get_sim_state() for worker in self.workers]

    def set_init_state(self, init_state: Any = None, id: _Ids = None) -> Any:
        """Sets states; returns observations in an array [n] of objects."""
        pairs = list(zip(self._choose(id), init_state))
        states = [state for _, state in pairs]
        chosen = [i for i, _ in pairs]
        if any(not _sets_states_concurrently(self.workers[i]) for i in chosen):
            return _stack([self.workers[i].set_init_state(state) for i, state in pairs])
        return _stack(
            self._exchange(chosen, lambda worker, at: worker.begin("set_init_state", states[at]))
        )

    def get_segmentation_of_interest(self, segmentation_images: Any) -> list[Any]:
        """See `SegmentationRenderEnv`."""
        self._assert_is_not_closed()
        return [
            worker.get_segmentation_of_interest(image)
            for worker, image in zip(self.workers, segmentation_images)
        ]

    def get_env_attr(self, key: str, id: _Ids = None) -> list[Any]:
        """Returns an attribute of each chosen environment."""
        return [self.workers[i].get_env_attr(key) for i in self._choose(id)]

    def set_env_attr(self, key: str, value: Any, id: _Ids = None) -> None:
        """Sets an attribute of each chosen environment."""
        for i in self._choose(id):
            self.workers[i].set_env_attr(key, value)

    def close(self) -> None:
        """Closes all environments, and then raises the first error of those that failed to
        close."""
        self._assert_is_not_closed()
        errors = []
        for worker in self.workers:
            try:
                worker.close()
            except Exception as error:  # noqa: BLE001
                errors.append(error)
        self.is_closed = True
        if errors:
            raise errors[0]

    def _exchange(self, chosen: Any, send: Callable[[Any, int], None]) -> list[Any]:
        """Calls `send` with each chosen worker and its position among them, and returns the
        workers' answers. All answers are received before the first error is raised: an answer
        left in its pipe would be taken for the answer to the next call."""
        errors: dict[int, Exception] = {}
        answers = []
        for at, i in enumerate(chosen):
            try:
                send(self.workers[i], at)
            except Exception as error:  # noqa: BLE001
                errors[at] = error
        for at, i in enumerate(chosen):
            if at in errors:
                continue
            try:
                answers.append(self.workers[i].recv())
            except Exception as error:  # noqa: BLE001
                errors[at] = error
        if errors:
            raise errors[min(errors)]
        return answers

    def _choose(self, id: _Ids) -> Any:
        self._assert_is_not_closed()
        return self._wrap_id(id)

    def _wrap_id(self, id: _Ids = None) -> Any:
        if id is None:
            return list(range(self.env_num))
        return [id] if np.isscalar(id) else id

    def _assert_id(self, id: Any) -> None:
        unknown = [i for i in id if i not in self.ready_id]
        if unknown:
            raise IndexError(
                f"there are no environments {unknown}: there are 0 to {self.env_num - 1}"
            )

    def _assert_is_not_closed(self) -> None:
        if self.is_closed:
            raise RuntimeError("the environments are closed: make new ones")


class DummyVectorEnv(BaseVectorEnv):
    """Environments in this process, stepped one after another."""

    def __init__(self, env_fns: Sequence[Callable[[], Any]], **kwargs: Any) -> None:
        super().__init__(env_fns, DummyEnvWorker, **kwargs)


class SubprocVectorEnv(BaseVectorEnv):
    """Environments in separate processes."""

    def __init__(self, env_fns: Sequence[Callable[[], Any]], **kwargs: Any) -> None:
        super().__init__(env_fns, SubprocEnvWorker, **kwargs)


def _sets_states_concurrently(worker: Any) -> bool:
    """Returns True if this worker can set its state while other workers set theirs, that is, unless
    its class overrides `set_init_state` or makes no concurrent calls."""
    kind = type(worker)
    return (
        getattr(kind, "set_init_state", None) is EnvWorker.set_init_state
        and kind.begin is not EnvWorker.begin
    )


def _has_info(result: Any) -> bool:
    """Returns True for a pair of an observation and an info. Observations themselves are not
    pairs."""
    return isinstance(result, (tuple, list)) and len(result) == 2 and isinstance(result[1], dict)


def _stack(observations: Sequence[Any]) -> np.ndarray:
    try:
        return np.stack(observations)
    except ValueError:
        array = np.empty(len(observations), dtype=object)
        array[:] = observations
        return array
