"""Exports of archived campaigns to LeRobot datasets, TensorBoard and Weights & Biases."""

from __future__ import annotations

import importlib
from types import ModuleType

from ..errors import SettingsError


def import_package(package: str) -> ModuleType:
    """Imports a package that an export needs. Raises SettingsError."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise SettingsError(
            f"failed to export: {error.name or package} is not installed; run pip install {package}"
        ) from error
