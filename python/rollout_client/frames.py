"""Conversion of rows to frames with typed columns: texts are `string`, outcomes that may be missing
are `boolean`, and instants are in UTC. Absent values become missing values of pandas."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import datetime, timedelta, timezone
from typing import Any

import pandas as pd

TEXT, INTEGER, COUNT, OUTCOME = "string", "Int64", "int64", "boolean"
FLAG, NUMBER, INSTANT, ARRAY = "bool", "float64", "datetime64[ms, UTC]", "object"


def of(dtype: str, names: str) -> dict[str, str]:
    """Returns the type of each of the named columns."""
    return dict.fromkeys(names.split(), dtype)


#: Columns of the reference implementation's `rollouts.jsonl`, and then, from `replicate` on, those
#: that `coordinator export` adds.
RESULTS = {
    **of(TEXT, "rollout_id"), **of(FLAG, "success"), **of(COUNT, "steps"),
    **of(TEXT, "axis level suite"), **of(COUNT, "task_id init_id"), **of(INTEGER, "config"),
    **of(TEXT, "policy"), **of(NUMBER, "wall_s ik_res_mm"), **of(COUNT, "replicate"),
    **of(NUMBER, "placebo_radius"), **of(TEXT, "execution"),
    **of(INTEGER, "goal_predicates goal_at_end goal_at_most"), **of(TEXT, "protocol prompt"),
}  # fmt: skip

#: Columns of the results of an archive.
ARCHIVED = {
    **of(TEXT, "rollout_id"), **of(COUNT, "replicate"), **of(TEXT, "task instruction axis level"),
    **of(FLAG, "success"), **of(COUNT, "steps"), **of(NUMBER, "wall_secs"),
    **of(INSTANT, "committed_at"), **of(ARRAY, "path actions"),
}  # fmt: skip

#: Columns with the names of `coordinator jobs --json`.
JOBS = {
    **of(TEXT, "rollout_id"), **of(COUNT, "replicate job_id"), **of(TEXT, "state outcome"),
    **of(INTEGER, "steps"), **of(COUNT, "attempts charged_attempts"),
    **of(TEXT, "attempt_id worker_id last_error"),
}  # fmt: skip

#: Columns with the names of `coordinator workers --json`.
WORKERS = {
    **of(TEXT, "worker_id host"), **of(COUNT, "slots leases"),
    **of(TEXT, "asset_pack mujoco_version renderer look program_version"),
    **of(FLAG, "is_alive has_signed_off"), **of(COUNT, "failures_in_a_row"),
    **of(TEXT, "stopped_reason"), **of(INSTANT, "registered_at last_call_at"),
}  # fmt: skip


def frame(rows: Iterable[Mapping[str, Any]], columns: Mapping[str, str]) -> pd.DataFrame:
    """Returns a frame with exactly these columns and types, even if rows lack some or have more."""
    rows = list(rows)
    data = {name: _column([row.get(name) for row in rows], columns[name]) for name in columns}
    result: pd.DataFrame = pd.DataFrame(data)
    return result


def instant(given: int | str) -> datetime:
    """Converts milliseconds since the Unix epoch, or an answer's text, to an instant in UTC."""
    if isinstance(given, str):
        return datetime.fromisoformat(given.replace("Z", "+00:00"))
    return datetime(1970, 1, 1, tzinfo=timezone.utc) + timedelta(milliseconds=given)


def _column(values: list[Any], dtype: str) -> pd.Series[Any]:
    # Without an explicit resolution, pandas would give all instants the resolution of the first.
    converted = pd.to_datetime(values, utc=True).as_unit("ms") if dtype == INSTANT else values
    column: pd.Series[Any] = pd.Series(converted, dtype=dtype)
    return column
