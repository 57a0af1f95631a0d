"""A policy's input: an episode at its start, then one observation per query.
This module checks that a message holds everything that the policy's description requests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .description import Description, State
from .proto import policy_pb2 as pb


@dataclass
class Episode:
    """One rollout, from its reset to its last query."""

    #: Name of the episode: rollout id, replicate and the attempt's random id.
    session: str
    #: Suite, for example "libero_goal".
    suite: str
    #: The instruction, verbatim: never to be replaced by a canonical sentence.
    instruction: str
    #: The policy's seed for this rollout and replicate.
    seed: int
    #: State that the policy keeps between queries; set it in `reset`. The server releases it when
    #: the episode is over.
    memory: Any = None

    def rng(self, query_index: int) -> np.random.Generator:
        """Random numbers of one query.

        They depend only on the seed and the query index, so that the order of requests, retries and
        batch neighbours cannot change a rollout."""
        key = np.array([self.seed, query_index], dtype=np.uint64)
        return np.random.Generator(np.random.Philox(key=key))


@dataclass(frozen=True)
class UnderWay:
    """Actions that were already scheduled when a query was sent."""

    #: Commands of the control steps from this observation on, float32 [n, 7], in the description's
    #: gripper convention. The first `delay` commands are executed in any case; the new answer
    #: replaces the commands after them.
    actions: np.ndarray
    #: Control steps until the answer takes effect; the first `delay` actions of the answer are
    #: dropped.
    delay: int


@dataclass(frozen=True)
class Observation:
    """The robot's camera frames and readings at one query."""

    episode: Episode
    #: Index within the episode: 0, 1, 2, ...
    query_index: int
    #: Frames by camera name: uint8 [height, width, 3], RGB, contiguous and owned by this
    #: observation. Row 0 is the BOTTOM of the picture, as the simulator renders it.
    images: Mapping[str, np.ndarray]
    #: Readings, float64, in the units that `State` documents.
    state: Mapping[State, np.ndarray] = field(default_factory=dict)
    #: Readings that the description names in `readings`, float64.
    readings: Mapping[str, np.ndarray] = field(default_factory=dict)
    #: Result of the policy's `prepare`.
    prepared: Any = None
    #: Set under real-time chunking, else None. A policy that uses it declares `real_time_chunking`
    #: in its description.
    under_way: UnderWay | None = None

    @property
    def rng(self) -> np.random.Generator:
        """This query's random generator, restarted at every access."""
        return self.episode.rng(self.query_index)

    def upright(self, camera: str) -> np.ndarray:
        """Returns a camera's frame with row 0 at the top, as a person sees it.
        A contiguous copy, as `torch.from_numpy` needs."""
        return self.images[camera][::-1].copy()

    def rotated(self, camera: str) -> np.ndarray:
        """Returns a camera's frame turned by 180 degrees: upright, with left
        and right exchanged. Most LIBERO checkpoints were trained on this. A
        contiguous copy, as `torch.from_numpy` needs."""
        return self.images[camera][::-1, ::-1].copy()

    def vector(self, *fields: State) -> np.ndarray:
        """Returns the given readings concatenated in this order; without
        arguments, all requested readings in their declared order."""
        return np.concatenate([self.state[field] for field in fields or self.state])


class UnusableObservation(ValueError):
    """An observation lacks an input that the policy's description requests."""


def read_observation(
    message: pb.Observation, episode: Episode, query_index: int, description: Description
) -> Observation:
    """Checks an observation against the description and unpacks it. Raises UnusableObservation,
    which names the missing or misshapen input."""
    frames = {image.camera: image for image in message.images}
    # One that is named has no field.
    readings = {reading.name or reading.field: reading for reading in message.state}
    images = {}
    for camera in description.cameras:
        frame = frames.get(camera.name)
        if frame is None:
            raise UnusableObservation(f"it has no frame of camera {camera.name!r}")
        shape = (camera.height, camera.width, 3)
        if (frame.height, frame.width) != shape[:2] or len(frame.rgb) != int(np.prod(shape)):
            raise UnusableObservation(
                f"the frame of camera {camera.name!r} is {frame.width}x{frame.height} in"
                f" {len(frame.rgb)} bytes, not {camera.width}x{camera.height} in"
                f" {int(np.prod(shape))}"
            )
        # Copied because arrays over a message's bytes are read-only.
        images[camera.name] = np.frombuffer(frame.rgb, dtype=np.uint8).reshape(shape).copy()
    state = {}
    for requested in description.state:
        reading = readings.get(requested.value)
        if reading is None:
            raise UnusableObservation(f"it has no reading {requested.name}")
        if len(reading.values) != requested.size:
            raise UnusableObservation(
                f"reading {requested.name} has {len(reading.values)} numbers, not {requested.size}"
            )
        state[requested] = np.array(reading.values, dtype=np.float64)
    named = {}
    for name in description.readings:
        if name not in readings:
            raise UnusableObservation(f"it has no reading {name!r}")
        named[name] = np.array(readings[name].values, dtype=np.float64)
    return Observation(episode, query_index, images, state, named)
