"""LIBERO without OpenGL: many environments in one process, faithful to the original.

``Environment`` and ``VectorEnvironment`` are gymnasium's interfaces to LIBERO's tasks."""

from rollout_libero._library import native as _native
from rollout_libero.capsule import Capsule
from rollout_libero.environment import Environment
from rollout_libero.files import MissingAssetsError, fetch_assets
from rollout_libero.tasks import Task, tasks
from rollout_libero.training import TrainingEnvironment
from rollout_libero.vector import VectorEnvironment

BusyError = _native.BusyError
ClosedError = _native.ClosedError
FilesError = _native.FilesError
SimulationError = _native.SimulationError
Schedule = _native.Schedule
Snapshot = _native.Snapshot

__all__ = [
    "BusyError", "Capsule", "ClosedError", "Environment", "FilesError", "MissingAssetsError",
    "Schedule", "SimulationError", "Snapshot", "Task", "TrainingEnvironment",
    "VectorEnvironment", "fetch_assets", "tasks",
]  # fmt: skip
