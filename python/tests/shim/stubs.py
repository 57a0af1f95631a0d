"""Environments without a scene. They are in a separate module, which the environments' processes
import too."""

import os
import signal
import time
from collections.abc import Callable
from typing import Any

import numpy as np


class Collision(Exception):
    """An error that can be pickled but not unpickled: its `args` lack the second argument."""

    def __init__(self, body: str, other: str) -> None:
        super().__init__(f"{body} touches {other}")


class Stub:
    """An environment whose actions are functions, which it calls in its own process."""

    def __init__(self) -> None:
        self.steps = 0

    def reset(self) -> int:
        return self.steps

    def step(self, action: Callable[[], Any]) -> Any:
        self.steps += 1
        return action(), 0.0, False, {"steps": self.steps}

    def close(self) -> None:
        pass


class Unclosable(Stub):
    def close(self) -> None:
        raise ValueError("the environment stays open")


def slow() -> Stub:
    time.sleep(0.6)
    return Stub()


def invalid() -> Stub:
    raise ValueError("the environment is invalid")


def colliding() -> Stub:
    raise Collision("cup", "plate")


def idle() -> None:
    pass


def frame() -> Any:
    """Returns a random frame, which is larger than a pipe's buffer."""
    return np.random.randint(0, 256, (256, 256, 3), dtype=np.uint8)


def collide() -> None:
    raise Collision("cup", "plate")


def raise_local() -> None:
    """Raises an error that cannot be pickled."""

    class Local(Exception):
        pass

    raise Local("only here")


def observe_collision() -> Collision:
    """Returns an observation that cannot be unpickled."""
    return Collision("cup", "plate")


def observe_function() -> Any:
    """Returns an observation that cannot be pickled."""
    return lambda: None


def interrupt() -> None:
    """Ends the process as Ctrl-C does, but without a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(60)
