"""A coordinator's campaigns, results and reports as pandas frames; start with Client."""

from __future__ import annotations

try:
    import google.protobuf as _protobuf  # noqa: F401
    import grpc as _grpc  # noqa: F401
    import pandas as _pandas  # noqa: F401
except ImportError as error:
    raise ImportError(
        f"rollout_client needs {error.name}: run pip install grpcio protobuf pandas",
        name=error.name,
    ) from error

from .campaign import Campaign
from .client import Client, Spec
from .report import Comparison, Report
from .status import Forecast, Status

__all__ = ["Campaign", "Client", "Comparison", "Forecast", "Report", "Spec", "Status"]
