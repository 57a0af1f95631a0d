"""Serves simulators to rollout workers: gymnasium, LeRobot and vla-eval, over one pipe."""

from .description import Camera, Description, Failed, Observation, Simulator, Step, Task, Unusable
from .pipe import Client, Lost, serve
from .settings import Settings

__all__ = [
    "Camera",
    "Client",
    "Description",
    "Failed",
    "Lost",
    "Observation",
    "Settings",
    "Simulator",
    "Step",
    "Task",
    "Unusable",
    "open_simulator",
    "serve",
]


def open_simulator(settings: Settings) -> Simulator:
    """Constructs the simulator of a SPEC; raises `Unusable`."""
    if settings.kind == "vla-eval":
        from .vla_eval import VlaEvalSimulator

        return VlaEvalSimulator(settings)
    from .gym import GymSimulator

    return GymSimulator(settings)
