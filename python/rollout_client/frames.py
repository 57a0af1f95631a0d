"""Conversion of rows to frames with typed columns: texts are `string`, outcomes that may be missing
are `boolean`, and instants are in UTC. Absent values become missing values of pandas."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import datetime, timedelta, timezone
from typing import Any

import pandas as pd

TEXT, INTEGER, COUNT, OUTCOME = "string", "Int64", "int64", "boolean"
FLAG, NUMBER, INSTANT = "bool", "float64", "datetime64[ms, UTC]"

#: Columns of the reference implementation's `rollouts.jsonl`, and then, from `replicate` on, those
#: that `coordinator export` adds.
RESULTS = {
    "rollout_id": TEXT,
    "success": FLAG,
    "steps": COUNT,
    "axis": TEXT,
    "level": TEXT,
    "suite": TEXT,
    "task_id": COUNT,
    "init_id": COUNT,
    "config": INTEGER,
    "policy": TEXT,
    "wall_s": NUMBER,
    "ik_res_mm": NUMBER,
    "replicate": COUNT,
    "placebo_radius": NUMBER,
    "execution": TEXT,
    "goal_predicates": INTEGER,
    "goal_at_end": INTEGER,
    "goal_at_most": INTEGER,
    "protocol": TEXT,
    "prompt": TEXT,
}

#: Columns with the names of `coordinator jobs list --json`.
JOBS = {
    "rollout_id": TEXT,
    "replicate": COUNT,
    "job_id": COUNT,
    "state": TEXT,
    "outcome": TEXT,
    "steps": INTEGER,
    "attempts": COUNT,
    "charged_attempts": COUNT,
    "attempt_id": TEXT,
    "worker_id": TEXT,
    "last_error": TEXT,
}

#: Columns with the names of `coordinator workers --json`.
WORKERS = {
    "worker_id": TEXT,
    "host": TEXT,
    "slots": COUNT,
    "leases": COUNT,
    "asset_pack": TEXT,
    "mujoco_version": TEXT,
    "renderer": TEXT,
    "look": TEXT,
    "program_version": TEXT,
    "is_alive": FLAG,
    "has_signed_off": FLAG,
    "failures_in_a_row": COUNT,
    "stopped_reason": TEXT,
    "registered_at": INSTANT,
    "last_call_at": INSTANT,
}


def frame(rows: Iterable[Mapping[str, Any]], columns: Mapping[str, str]) -> pd.DataFrame:
    """Returns a frame with exactly these columns and types, even if rows lack some or have more."""
    rows = list(rows)
    data = {name: _column([row.get(name) for row in rows], columns[name]) for name in columns}
    result: pd.DataFrame = pd.DataFrame(data)
    return result


def instant(unix_ms: int) -> datetime:
    """Converts milliseconds since the Unix epoch to an instant in UTC."""
    return datetime(1970, 1, 1, tzinfo=timezone.utc) + timedelta(milliseconds=unix_ms)


def _column(values: list[Any], dtype: str) -> pd.Series[Any]:
    # Without an explicit resolution, pandas would give all instants the resolution of the first.
    converted = pd.to_datetime(values, utc=True).as_unit("ms") if dtype == INSTANT else values
    column: pd.Series[Any] = pd.Series(converted, dtype=dtype)
    return column
