"""A policy's description: plain data, checked when it is created."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field

from .proto import policy_pb2 as pb

PROTOCOL_VERSION = 1
#: Longest chunk that a policy may declare: twice the length of LIBERO's longest episode.
MAX_HORIZON = 1040
#: Longest text of a description, bytes: the limit of texts in results.
MAX_TEXT_BYTES = 512
#: Largest message, in bytes: as in the gateway and the worker.
MAX_MESSAGE_BYTES = 32 << 20


class State(enum.Enum):
    """Robot readings that a policy may request, in SI units and in the world frame."""

    #: Position of the site between the fingertips, m (3).
    EEF_POS = pb.STATE_FIELD_EEF_POS
    #: Orientation of the hand body, as a quaternion x y z w (4).
    EEF_QUAT_XYZW = pb.STATE_FIELD_EEF_QUAT_XYZW
    #: The same orientation as axis times angle, rad (3), without changing the quaternion's sign.
    EEF_AXIS_ANGLE = pb.STATE_FIELD_EEF_AXIS_ANGLE
    #: The same orientation as a rotation matrix, row by row (9).
    EEF_ROTATION = pb.STATE_FIELD_EEF_ROTATION
    #: The seven arm joints, rad (7).
    JOINT_POS = pb.STATE_FIELD_JOINT_POS
    #: The seven arm joints, rad/s (7).
    JOINT_VEL = pb.STATE_FIELD_JOINT_VEL
    #: The two finger joints, m (2).
    GRIPPER_POS = pb.STATE_FIELD_GRIPPER_POS
    #: The two finger joints, m/s (2).
    GRIPPER_VEL = pb.STATE_FIELD_GRIPPER_VEL

    @property
    def size(self) -> int:
        """Number of values in the reading."""
        return _SIZES[self]


_SIZES = {
    State.EEF_POS: 3, State.EEF_QUAT_XYZW: 4, State.EEF_AXIS_ANGLE: 3, State.EEF_ROTATION: 9,
    State.JOINT_POS: 7, State.JOINT_VEL: 7, State.GRIPPER_POS: 2, State.GRIPPER_VEL: 2,
}  # fmt: skip


class Language(enum.Enum):
    """Kinds of instructions that a policy accepts."""

    #: Any sentence.
    FREE_FORM = pb.LANGUAGE_FREE_FORM
    #: Only the 40 canonical instructions: the language axis changes nothing.
    CANONICAL_ONLY = pb.LANGUAGE_CANONICAL_ONLY
    #: The instruction is ignored.
    IGNORED = pb.LANGUAGE_IGNORED


class Gripper(enum.Enum):
    """Meaning of the seventh number of a policy's actions.

    The simulator expects -1 to open and 1 to close; this package converts the answers of a policy
    that declares another convention. Conventions between 0 and 1 are thresholded at one half, and
    become -1 or 1; exactly one half becomes 0."""

    #: LIBERO's own convention. Values between -1 and 1 are kept.
    MINUS_ONE_OPENS = "-1 open, 1 closed"
    #: The opposite of LIBERO's convention: the conversion changes the sign.
    ONE_OPENS = "-1 closed, 1 open"
    #: The convention of RLDS data, and so of OpenVLA, Octo and related policies.
    RLDS = "0 closed, 1 open"
    #: The opposite of RLDS.
    ZERO_OPENS = "0 open, 1 closed"


@dataclass(frozen=True)
class Camera:
    """A camera, and the size of its frames in pixels."""

    #: "agentview", "robot0_eye_in_hand", or another one of a simulator other than LIBERO's.
    name: str
    width: int = 256
    height: int = 256

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ValueError(f"camera {self.name!r}: {self.width}x{self.height} has no pixels")


@dataclass(frozen=True)
class Description:
    """Properties of a policy and the inputs that it needs.

    `horizon` is the largest number of actions in an answer, `execute` the number that the robot
    runs before the next query (all of them by default). An inconsistent description raises
    ValueError."""

    name: str
    horizon: int = 1
    execute: int | None = None
    cameras: tuple[Camera, ...] = ()
    state: tuple[State, ...] = ()
    #: Further readings, by the names that a simulator other than LIBERO gives them.
    readings: tuple[str, ...] = ()
    #: Id of the weights as their publisher writes it, and their digest.
    checkpoint: str = ""
    checkpoint_digest: str = ""
    #: Number of parameters of the network; 0 if unknown.
    parameters: int = 0
    #: The policy keeps state in `episode.memory` between the queries of an episode.
    stateful: bool = False
    #: The policy draws random numbers, so its actions depend on the seed.
    stochastic: bool = False
    language: Language = Language.FREE_FORM
    #: Largest batch: above 1, `infer_batch` answers up to this many queries at once.
    max_batch: int = 1
    #: Meaning of the seventh number of an action.
    gripper: Gripper = Gripper.MINUS_ONE_OPENS
    #: Resolved settings that determine the actions, one fact each, for example {"image slots":
    #: "image=agentview", "revision": "1f2e3d"}. Recorded with every result; they must be the same
    #: for all results of a campaign and suite.
    settings: Mapping[str, str] = field(default_factory=dict, hash=False)
    #: Name or digest of the asset pack used in training, such as "libero". Reports warn if the
    #: policy is measured on another pack.
    taught_on: str = ""
    #: The policy uses `observation.under_way`: its answers continue the actions that are executed
    #: while it computes.
    real_time_chunking: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", tuple(self.cameras))
        object.__setattr__(self, "state", tuple(self.state))
        object.__setattr__(self, "readings", tuple(self.readings))
        object.__setattr__(self, "settings", dict(self.settings))
        if not self.name:
            raise ValueError("a policy needs a name")
        if not 1 <= self.horizon <= MAX_HORIZON:
            raise ValueError(
                f"policy {self.name!r}: horizon is {self.horizon}, not within 1..{MAX_HORIZON}"
            )
        execute = self.horizon if self.execute is None else self.execute
        object.__setattr__(self, "execute", execute)
        if not 1 <= execute <= self.horizon:
            raise ValueError(
                f"policy {self.name!r}: execute is {execute} and horizon {self.horizon};"
                " 1 <= execute <= horizon must hold"
            )
        for attribute in ("name", "checkpoint", "checkpoint_digest"):
            size = len(getattr(self, attribute).encode())
            if size > MAX_TEXT_BYTES:
                raise ValueError(
                    f"policy {self.name[:64]!r}: {attribute} has {size} bytes, and results hold"
                    f" at most {MAX_TEXT_BYTES}"
                )
        for readings in (self.state, self.readings):
            if len(set(readings)) != len(readings):
                raise ValueError(f"policy {self.name!r}: a reading is named twice in {readings}")
        names = [camera.name for camera in self.cameras]
        if len(set(names)) != len(names):
            raise ValueError(f"policy {self.name!r}: one camera is named twice in {names}")
        size = sum(3 * camera.width * camera.height for camera in self.cameras)
        if size > MAX_MESSAGE_BYTES:
            raise ValueError(
                f"policy {self.name!r}: its frames are {size} bytes per query, and a message"
                f" holds at most {MAX_MESSAGE_BYTES}"
            )
        for name, value in self.settings.items():
            if not (isinstance(name, str) and name and isinstance(value, str)):
                raise ValueError(
                    f"policy {self.name!r}: setting {name!r} is {value!r}; names and values of"
                    " settings must be strings"
                )

    def to_message(self) -> pb.DescribeResponse:
        """Returns the description as a message. Its settings name the gripper convention
        if this package converts the gripper's commands."""
        settings = dict(self.settings)
        if self.gripper is not Gripper.MINUS_ONE_OPENS:
            settings.setdefault("gripper", self.gripper.value)
        if self.taught_on:
            settings.setdefault("taught on", self.taught_on)
        return pb.DescribeResponse(
            protocol_version=PROTOCOL_VERSION,
            name=self.name,
            checkpoint=self.checkpoint,
            checkpoint_digest=self.checkpoint_digest,
            parameters=self.parameters,
            cameras=[
                pb.CameraRequest(name=camera.name, width=camera.width, height=camera.height)
                for camera in self.cameras
            ],
            state=[field.value for field in self.state],
            readings=self.readings,
            horizon=self.horizon,
            execute=self.execute,
            stateful=self.stateful,
            stochastic=self.stochastic,
            language=self.language.value,
            max_batch=self.max_batch,
            real_time_chunking=self.real_time_chunking,
            settings=[pb.Setting(name=name, value=value) for name, value in settings.items()],
        )

    def lines(self) -> list[str]:
        """Returns all resolved settings, one `name: value` line each, for people."""
        cameras = [f"{camera.name} {camera.width}x{camera.height}" for camera in self.cameras]
        facts = {
            "policy": self.name,
            "checkpoint": self.checkpoint,
            "digest": self.checkpoint_digest,
            "parameters": f"{self.parameters:,}" if self.parameters else "",
            "cameras": ", ".join(cameras) or "none",
            "state": ", ".join(reading.name.lower() for reading in self.state) or "none",
            "readings": ", ".join(self.readings),
            "horizon": f"{self.horizon}",
            "execute": f"{self.execute}",
            "gripper": self.gripper.value,
            "batches": f"up to {self.max_batch}" if self.max_batch > 1 else "",
            "taught on": self.taught_on,
            **self.settings,
        }
        return [f"{name}: {value}" for name, value in facts.items() if value]
