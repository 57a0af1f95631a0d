"""Serve a robot policy to a rollout campaign.

Subclass `Policy`, describe the policy and its inputs in `description`, implement `reset` and
`infer`, and call `run`, or `serve` with an instance of your own. This package implements the
protocol: sessions, retries, checks and errors. The policy only computes actions. `check` runs
`policy-gateway check` on a policy, and `fake_observation` generates an observation of the kind that
the policy receives."""

from .access import AccessError, UnguardedAddress
from .actions import UnusableActions
from .check import DoesNotConform, check
from .command import run
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
