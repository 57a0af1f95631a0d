"""Campaigns for other tools, from archives: LeRobot datasets, TensorBoard, Weights & Biases."""

from __future__ import annotations

import importlib
from types import ModuleType

from ..errors import SettingsError


def needed(package: str, extra: str) -> ModuleType:
    """A package that an export needs and an extra installs. Raises SettingsError."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise SettingsError(
            f"failed to export: {error.name or package} is not installed; run pip install"
            f" 'rollout-libero[{extra}]'"
        ) from error
