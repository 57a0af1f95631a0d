"""Serve a robot policy to a rollout campaign.

Subclass `Policy`, say in `description` what it is and wants to see, implement
`reset` and `infer`, and call `run`, or `serve` with a policy made by yourself.
This package is responsible for the wire: sessions, retries, checks and errors.
The numbers are the policy's. `check` tells whether a policy keeps the protocol,
`fake_observation` makes up what it would be shown.
"""

from .access import AccessError, UnguardedAddress
from .actions import UnusableActions
from .command import run
from .conformance import CannotCheck, DoesNotConform, check
from .description import Camera, Description, Gripper, Language, State
from .episode import Episode, Observation, UnderWay, UnusableObservation
from .fake import fake_episode, fake_observation
from .policy import Policy, UnusableDescription
from .processing.actions import Ensemble
from .processing.images import BILINEAR, LANCZOS3, resize
from .processing.robot import gripper_from_rlds
from .server import CannotListen, Server, serve, start

__all__ = [
    "BILINEAR",
    "LANCZOS3",
    "AccessError",
    "Camera",
    "CannotCheck",
    "CannotListen",
    "Description",
    "DoesNotConform",
    "Ensemble",
    "Episode",
    "Gripper",
    "Language",
    "Observation",
    "Policy",
    "Server",
    "State",
    "UnderWay",
    "UnguardedAddress",
    "UnusableActions",
    "UnusableDescription",
    "UnusableObservation",
    "check",
    "fake_episode",
    "fake_observation",
    "gripper_from_rlds",
    "resize",
    "run",
    "serve",
    "start",
]
