"""The messages' contents, in the vocabulary of `rollout.policy.v1`, and the errors."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import numpy as np

#: Version of the protocol; a worker refuses another one.
PROTOCOL = 1
#: Dimensions of an action that have a meaning for the actuation axis, in the order of
#: LIBERO's actions: a simulator has some or all of them.
DIMENSIONS = ("x", "y", "z", "roll", "pitch", "yaw", "gripper")


class Unusable(Exception):
    """The environment cannot be served at all: a package, an option or a value is missing."""


class Failed(Exception):
    """The environment broke its description, or raised, in one rollout."""


@dataclass(frozen=True)
class Camera:
    """A camera that the simulator offers; `any_size` if it draws frames of any size."""

    name: str
    width: int
    height: int
    any_size: bool = False


@dataclass(frozen=True)
class Task:
    """A task: its name in rollout ids, the instruction, and the budget in control steps."""

    name: str
    instruction: str
    max_steps: int


@dataclass(frozen=True)
class Description:
    """What a simulator offers."""

    name: str
    tasks: list[Task]
    cameras: list[Camera]
    #: Sizes of the readings by name.
    state: dict[str, int]
    #: One of `DIMENSIONS` for each number of an action; empty for a number without such a meaning.
    action: list[str]
    control_hz: float
    #: Axes that act in the simulator, through `reset(options={"perturb": …})`.
    axes: list[str]
    #: Distributions that were loaded, by name: version and digest of their files.
    packages: dict[str, str] = field(default_factory=dict)
    #: Name of the OpenGL driver; empty if nothing was drawn through OpenGL.
    driver: str = ""
    #: True if environments are reused from rollout to rollout.
    reused: bool = False

    def to_json(self) -> dict[str, Any]:
        """Returns the answer to Describe."""
        return {"protocol": PROTOCOL, **asdict(self)}


@dataclass(frozen=True)
class Observation:
    """Frames by camera, upright, RGB with 8 bits; readings by name."""

    frames: dict[str, np.ndarray]
    state: dict[str, np.ndarray]
    #: All that the environment returned, of which the readings may be a part.
    whole: dict[str, np.ndarray]

    def digest(self) -> str:
        """Returns the SHA-256 of names, shapes and bits of the frames and the whole, hex."""
        sha = hashlib.sha256()
        for values in (self.frames, self.whole):
            for name, array in sorted(values.items()):
                sha.update(f"{name} {array.shape} {array.dtype}\n".encode())
                sha.update(np.ascontiguousarray(array).tobytes())
        return sha.hexdigest()


@dataclass(frozen=True)
class Step:
    """End of a control step."""

    success: bool
    ended: bool


class Simulator(Protocol):
    """What the pipe serves. Frames are drawn by `observe` only."""

    description: Description

    def reset(self, task: str, seed: int, perturb: dict[str, Any]) -> None: ...

    def step(self, action: np.ndarray) -> Step: ...

    def observe(self, cameras: list[Camera]) -> Observation: ...

    def close(self) -> None: ...


def check_observation(about: Description, cameras: list[Camera], seen: Observation) -> None:
    """Raises `Failed` for an observation that the description does not announce."""
    for camera in cameras:
        frame = seen.frames[camera.name]
        expected = (camera.height, camera.width, 3)
        if frame.shape != expected or frame.dtype != np.uint8:
            raise Failed(
                f"camera `{camera.name}` returned {frame.dtype} {frame.shape}, not uint8 "
                f"{expected}: give the environment one size for all its frames"
            )
    for name, size in about.state.items():
        reading = seen.state[name]
        if reading.shape != (size,):
            raise Failed(
                f"reading `{name}` has the shape {reading.shape}, not ({size},): name readings "
                "that all tasks share with --state"
            )
        if not np.isfinite(reading).all():
            raise Failed(f"reading `{name}` holds NaN or infinity: the simulation diverged")
