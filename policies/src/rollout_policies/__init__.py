"""Serve a robot policy to a rollout campaign.

Subclass `Policy`, say in `description` what it is and wants to see, implement
`reset` and `infer`, and call `serve`. This package is responsible for the wire:
sessions, retries, checks and errors. The numbers are the policy's.
"""

from .description import Camera, Description, Language, State
from .episode import Episode, Observation
from .policy import Policy
from .server import Server, serve, start

__all__ = [
    "Camera",
    "Description",
    "Episode",
    "Language",
    "Observation",
    "Policy",
    "Server",
    "State",
    "serve",
    "start",
]
