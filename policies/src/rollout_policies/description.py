"""A policy's description: plain data, checked when it is made."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Mapping

from .proto import policy_pb2 as pb

PROTOCOL_VERSION = 1


class State(enum.Enum):
    """Robot readings that a policy may ask for, in SI units, world frame."""

    #: Position of the site between the fingertips, m (3).
    EEF_POS = pb.STATE_FIELD_EEF_POS
    #: Orientation of the hand body, quaternion x y z w (4).
    EEF_QUAT_XYZW = pb.STATE_FIELD_EEF_QUAT_XYZW
    #: The same as axis times angle, rad (3), antipodes not flipped.
    EEF_AXIS_ANGLE = pb.STATE_FIELD_EEF_AXIS_ANGLE
    #: The same as a rotation matrix, row by row (9).
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
        """How many numbers the reading has."""
        return _SIZES[self]


_SIZES = {
    State.EEF_POS: 3,
    State.EEF_QUAT_XYZW: 4,
    State.EEF_AXIS_ANGLE: 3,
    State.EEF_ROTATION: 9,
    State.JOINT_POS: 7,
    State.JOINT_VEL: 7,
    State.GRIPPER_POS: 2,
    State.GRIPPER_VEL: 2,
}


class Language(enum.Enum):
    """Which instructions a policy can be given."""

    #: Any sentence.
    FREE_FORM = pb.LANGUAGE_FREE_FORM
    #: Only the 40 canonical instructions: the language axis is the identity.
    CANONICAL_ONLY = pb.LANGUAGE_CANONICAL_ONLY
    #: The instruction is not looked at.
    IGNORED = pb.LANGUAGE_IGNORED


@dataclass(frozen=True)
class Camera:
    """Frames of one camera, in pixels."""

    #: "agentview" or "robot0_eye_in_hand".
    name: str
    width: int = 256
    height: int = 256

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ValueError(f"camera {self.name!r}: {self.width}x{self.height} has no pixels")


@dataclass(frozen=True)
class Description:
    """What a policy is and wants to see.

    `horizon` is the most actions that one query may answer, `execute` how many
    of them the robot runs before the next query (all of them by default).
    """

    name: str
    horizon: int = 1
    execute: int | None = None
    cameras: tuple[Camera, ...] = ()
    state: tuple[State, ...] = ()
    #: Id of the weights as their publisher writes it, and a digest of them.
    checkpoint: str = ""
    checkpoint_digest: str = ""
    parameters: int = 0
    #: Keeps something in `episode.memory` between the queries of an episode.
    stateful: bool = False
    #: Draws random numbers: other seeds give other actions.
    stochastic: bool = False
    language: Language = Language.FREE_FORM
    #: Above 1: `infer_batch` answers up to so many queries at once.
    max_batch: int = 1
    #: What was resolved when the policy was loaded and decides its actions, one
    #: fact each, for example {"image slots": "image=agentview"}. Recorded with
    #: every result; the results of one campaign and suite share them.
    settings: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", tuple(self.cameras))
        object.__setattr__(self, "state", tuple(self.state))
        if not self.name:
            raise ValueError("a policy needs a name")
        if self.execute is None:
            object.__setattr__(self, "execute", self.horizon)
        if not 1 <= self.execute <= self.horizon:
            raise ValueError(
                f"policy {self.name!r}: execute is {self.execute} and horizon {self.horizon};"
                " 1 <= execute <= horizon must hold"
            )
        names = [camera.name for camera in self.cameras]
        if len(set(names)) != len(names):
            raise ValueError(f"policy {self.name!r}: one camera is named twice in {names}")

    def to_message(self) -> pb.DescribeResponse:
        """The same on the wire."""
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
            horizon=self.horizon,
            execute=self.execute,
            stateful=self.stateful,
            stochastic=self.stochastic,
            language=self.language.value,
            max_batch=self.max_batch,
            settings=[pb.Setting(name=name, value=value) for name, value in self.settings.items()],
        )
