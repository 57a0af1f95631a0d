"""What a policy is given: an episode at its start, then one observation per
query. Responsible for checking that a message holds what was asked for."""

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

    #: Rollout id, replicate and the attempt's random id: names the episode.
    session: str
    #: For example "libero_goal".
    suite: str
    #: What to do, verbatim: never to be replaced by a canonical sentence.
    instruction: str
    #: The policy's seed of this rollout and replicate.
    seed: int
    #: Whatever the policy keeps between queries; set it in `reset`. The server
    #: lets go of it when the episode is over.
    memory: Any = None

    def rng(self, query_index: int) -> np.random.Generator:
        """Random numbers of one query.

        They depend on the seed and the query index alone, so that neither the
        order of requests nor a retry nor a batch neighbour changes a rollout.
        """
        key = np.array([self.seed, query_index], dtype=np.uint64)
        return np.random.Generator(np.random.Philox(key=key))


@dataclass(frozen=True)
class UnderWay:
    """Actions that the robot executes while the answer to a query is under way."""

    #: Commands of the control steps from this observation on, float32 [n, 7], with the
    #: gripper as the description says. The first `delay` are executed whatever is answered;
    #: those behind them are what is left of the last answer, and this one replaces them.
    actions: np.ndarray
    #: Control steps until the answer takes effect: its first `delay` actions are dropped.
    delay: int


@dataclass(frozen=True)
class Observation:
    """What the robot sees and feels at one query."""

    episode: Episode
    #: 0, 1, 2, ... within the episode.
    query_index: int
    #: By camera name: uint8 [height, width, 3], RGB, contiguous and this
    #: observation's own. Row 0 is the BOTTOM of the picture, as the simulator
    #: renders it.
    images: Mapping[str, np.ndarray]
    #: By reading: float64, in the units that `State` names.
    state: Mapping[State, np.ndarray] = field(default_factory=dict)
    #: What the policy's `prepare` made of it.
    prepared: Any = None
    #: Under real-time chunking, None otherwise; say `real_time_chunking` in the description if
    #: it is heeded.
    under_way: UnderWay | None = None

    @property
    def rng(self) -> np.random.Generator:
        """This query's random numbers, from their beginning at every use."""
        return self.episode.rng(self.query_index)

    def upright(self, camera: str) -> np.ndarray:
        """A camera's frame with row 0 at the top: what a person would see. A
        contiguous copy, as `torch.from_numpy` wants it."""
        return self.images[camera][::-1].copy()

    def rotated(self, camera: str) -> np.ndarray:
        """A camera's frame turned by 180 degrees: upright, left and right
        exchanged. Most LIBERO checkpoints were trained on this. A contiguous
        copy, as `torch.from_numpy` wants it."""
        return self.images[camera][::-1, ::-1].copy()

    def vector(self, *fields: State) -> np.ndarray:
        """Readings end to end, in this order; all that were asked for, in
        their declared order, if none is named."""
        return np.concatenate([self.state[field] for field in fields or self.state])


class UnusableObservation(ValueError):
    """An observation lacks what the policy's description asks for."""


def read_observation(
    message: pb.Observation, episode: Episode, query_index: int, description: Description
) -> Observation:
    """Checks an observation against the description and unpacks it.

    Raises UnusableObservation, naming what is missing or misshapen.
    """
    frames = {image.camera: image for image in message.images}
    readings = {reading.field: reading for reading in message.state}
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
        # A copy, because what lies in a message cannot be written to.
        images[camera.name] = np.frombuffer(frame.rgb, dtype=np.uint8).reshape(shape).copy()
    state = {}
    for wanted in description.state:
        reading = readings.get(wanted.value)
        if reading is None:
            raise UnusableObservation(f"it has no reading {wanted.name}")
        if len(reading.values) != wanted.size:
            raise UnusableObservation(
                f"reading {wanted.name} has {len(reading.values)} numbers, not {wanted.size}"
            )
        state[wanted] = np.array(reading.values, dtype=np.float64)
    return Observation(episode, query_index, images, state)
