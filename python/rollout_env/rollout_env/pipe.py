"""The pipe between a worker and a simulator: `docs/SIMULATORS.md` describes the messages."""

from __future__ import annotations

import ctypes
import json
import mmap
import os
import signal
import socket
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from .description import (
    PROTOCOL,
    Camera,
    Description,
    Failed,
    Observation,
    Simulator,
    Step,
    Unusable,
    check_observation,
)

#: Longest line, bytes; the worker's limit.
MAX_LINE = 1 << 20


class Server:
    """Answers a worker's messages from a simulator, one at a time."""

    def __init__(self, connection: socket.socket, make: Callable[[], Simulator]) -> None:
        self._stream = connection.makefile("rwb")
        self._make = make
        self._simulator: Simulator
        self._file: Any = None
        self._frames: mmap.mmap | None = None
        self._cameras: list[Camera] = []
        #: A rollout is under way: Step is allowed.
        self._running = False

    def run(self) -> None:
        """Serves until Close, or until the worker closes the connection."""
        while line := self._stream.readline(MAX_LINE):
            message = json.loads(line)
            ((name, request),) = message.items()
            if name == "close":
                return
            try:
                answer = {name: self._answer(name, request)}
            except Unusable as error:
                answer = error_message("unusable", str(error))
            except Exception as error:
                self._running = False
                if not isinstance(error, Failed):
                    traceback.print_exc()
                text = str(error) if isinstance(error, Failed) else f"{name} raised {error!r}"
                answer = error_message("failed", text)
            self._stream.write(json.dumps(answer).encode() + b"\n")
            self._stream.flush()

    def _answer(self, name: str, request: dict[str, Any]) -> dict[str, Any]:
        if name == "describe":
            if request["protocol"] != PROTOCOL:
                raise Unusable(
                    f"the worker speaks version {request['protocol']} of the pipe, rollout-env "
                    f"version {PROTOCOL}: install the rollout-env of the worker's release"
                )
            self._file = open(request["frames"], "r+b")
            self._simulator = self._make()
            return self._simulator.description.to_json()
        if name == "reset":
            return self._reset(**request)
        if name == "step":
            return self._step(**request)
        raise Failed(
            f"the worker sent `{name}`: this rollout-env knows describe, reset, step, close"
        )

    def _reset(
        self, task: str, seed: int, cameras: list[dict[str, Any]], perturb: dict[str, Any]
    ) -> dict[str, Any]:
        about = self._simulator.description
        self._running = False
        _require("task", task, [one.name for one in about.tasks], about)
        for axis in perturb:
            _require("axis", axis, about.axes, about)
        offered = {camera.name: camera for camera in about.cameras}
        self._cameras = [Camera(**camera) for camera in cameras]
        for camera in self._cameras:
            _require("camera", camera.name, list(offered), about)
            own = offered[camera.name]
            if not own.any_size and (own.width, own.height) != (camera.width, camera.height):
                raise Failed(
                    f"camera `{own.name}` draws {own.width}×{own.height}, not {camera.width}×"
                    f"{camera.height}: ask for that size, or serve a `mujoco.` camera"
                )
        self._map(sum(camera.width * camera.height * 3 for camera in self._cameras))
        self._simulator.reset(task, seed, perturb)
        self._running = True
        seen = self._observe(True)
        return {"digest": seen.digest(), "state": _numbers(seen)}

    def _step(self, actions: list[list[float]], frames: bool) -> dict[str, Any]:
        if not self._running:
            raise Failed("the worker sent a step outside a rollout: send reset first")
        width = len(self._simulator.description.action)
        executed, step = 0, Step(False, False)
        for action in actions:
            if len(action) != width:
                raise Failed(f"an action has {len(action)} numbers, {width} are described")
            step = self._simulator.step(np.asarray(action, dtype=np.float64))
            executed += 1
            if step.success or step.ended:
                self._running = False
                break
        seen = self._observe(frames)
        return {"executed": executed, **asdict(step), "state": _numbers(seen)}

    def _observe(self, frames: bool) -> Observation:
        """Observes, and writes the frames to the shared memory, bottom row first."""
        cameras = self._cameras if frames else []
        seen = self._simulator.observe(cameras)
        check_observation(self._simulator.description, cameras, seen)
        offset = 0
        for camera in cameras:
            size = camera.width * camera.height * 3
            assert self._frames is not None
            shared = np.frombuffer(self._frames, np.uint8, size, offset)
            shared.reshape(camera.height, camera.width, 3)[:] = seen.frames[camera.name][::-1]
            offset += size
        return seen

    def _map(self, size: int) -> None:
        if size and (self._frames is None or len(self._frames) != size):
            self._file.truncate(size)
            self._frames = mmap.mmap(self._file.fileno(), size)


def serve(make: Callable[[], Simulator]) -> None:
    """Serves the worker on standard input, which must be a socket."""
    try:
        connection = socket.socket(fileno=os.dup(0))
    except OSError as error:
        raise Unusable(
            "standard input is no socket: another program starts this command, as "
            "`rollout_env.Client` does; to try an environment, use `check`"
        ) from error
    _end_with_the_worker()
    Server(connection, make).run()


def _end_with_the_worker() -> None:
    """Makes the kernel kill this process with its parent, even while native code hangs."""
    if sys.platform == "linux":
        pr_set_pdeathsig = 1
        ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL, 0, 0, 0)


def error_message(kind: str, text: str) -> dict[str, Any]:
    """Returns the answer to a message that could not be served."""
    return {"error": {"kind": kind, "message": text}}


def _require(kind: str, given: str, known: list[str], about: Description) -> None:
    if given not in known:
        valid = ", ".join(known) if known else "none"
        raise Failed(f"`{about.name}` has no {kind} `{given}`; it has: {valid}")


def _numbers(seen: Observation) -> dict[str, list[float]]:
    return {name: reading.tolist() for name, reading in seen.state.items()}


class Lost(Exception):
    """The simulator's process ended, or did not answer in time."""


class Client:
    """A worker's side of the pipe, for tests, measurements and scripts."""

    def __init__(self, command: list[str], timeout: float = 600.0) -> None:
        ours, theirs = socket.socketpair()
        self._process = subprocess.Popen(command, stdin=theirs.fileno())
        theirs.close()
        #: Longest wait for an answer, s.
        self.timeout = timeout
        self._socket = ours
        self._stream = ours.makefile("rwb")
        self._cameras: list[Camera] = []
        folder = "/dev/shm" if os.path.isdir("/dev/shm") else None
        # Both sides have it open when it loses its name, so that nothing is left behind.
        with tempfile.NamedTemporaryFile(dir=folder) as file:
            self._frames = os.dup(file.fileno())
            self.description = self.call("describe", protocol=PROTOCOL, frames=file.name)

    def call(self, name: str, **request: Any) -> dict[str, Any]:
        """Sends a message and returns its answer; raises `Unusable`, `Failed` or `Lost`."""
        self._socket.settimeout(self.timeout)
        try:
            self._stream.write(json.dumps({name: request}).encode() + b"\n")
            self._stream.flush()
            line = self._stream.readline()
        except TimeoutError as error:
            self._process.kill()
            raise Lost(f"{name} was not answered in {self.timeout} s") from error
        except BrokenPipeError:
            line = b""
        if not line:
            raise Lost(f"the process ended with {self._process.wait()} before it answered {name}")
        answer = json.loads(line)
        if "error" in answer:
            kind = {"unusable": Unusable}.get(answer["error"]["kind"], Failed)
            raise kind(answer["error"]["message"])
        return answer[name]

    def reset(
        self, task: str, seed: int, cameras: list[Camera], perturb: dict[str, Any] | None = None
    ) -> dict[str, Any]:
        """Starts a rollout."""
        self._cameras = cameras
        asked = [{key: asdict(one)[key] for key in ("name", "width", "height")} for one in cameras]
        return self.call("reset", task=task, seed=seed, cameras=asked, perturb=perturb or {})

    def step(self, actions: list[list[float]], frames: bool = True) -> dict[str, Any]:
        """Executes actions; the last one's frames are in the shared memory afterwards."""
        return self.call("step", actions=actions, frames=frames)

    def frames(self) -> dict[str, np.ndarray]:
        """Returns the frames as the policy protocol has them: the bottom row first."""
        frames, offset = {}, 0
        for camera in self._cameras:
            size = camera.width * camera.height * 3
            pixels = np.frombuffer(os.pread(self._frames, size, offset), np.uint8)
            frames[camera.name] = pixels.reshape(camera.height, camera.width, 3)
            offset += size
        return frames

    def close(self) -> None:
        """Ends the process."""
        try:
            self._stream.write(b'{"close": {}}\n')
            self._stream.close()
        except OSError:
            pass
        os.close(self._frames)
        self._process.wait(self.timeout)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
