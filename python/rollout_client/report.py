"""Reports and comparisons as frames. The program `coordinator` computes them; this
module only arranges their JSON and their table (docs/REPORT.md defines each figure)."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pandas as pd

from . import frames
from .connection import Connection
from .frames import COUNT, INTEGER, NUMBER, OUTCOME, TEXT, of
from .program import Program

AXES = ("camera", "lighting", "robot", "sensor", "actuation", "language")
#: Paired measures that have a 95 % interval.
INTERVALS = ("d", "i", "r_e", "r_c", "r_d")

SUCCESS = {
    **of(TEXT, "policy level condition"), **of(COUNT, "successes n"), **of(NUMBER, "rate"),
    **of(COUNT, "missing quarantined"),
}  # fmt: skip

SUITES = {
    **of(TEXT, "policy level condition suite"), **of(COUNT, "successes n"),
    **of(NUMBER, "rate ci95_low ci95_high"),
}  # fmt: skip

PAIRED = {
    **of(TEXT, "policy level"), **of(COUNT, "n tasks"),
    **of(NUMBER, " ".join(f"s_{axis}" for axis in AXES)), **of(NUMBER, "s_indep s_conj s_sim"),
    **of(NUMBER, " ".join(f"{name} {name}_ci95_low {name}_ci95_high" for name in INTERVALS)),
    **of(COUNT, "b c"), **of(NUMBER, "emergent_share mcnemar_p"), **of(TEXT, "no_interval"),
}  # fmt: skip

#: Columns of `coordinator report --table`, with the types of its Parquet files; all others are
#: outcomes.
CONFIGURATIONS = {
    **of(TEXT, "policy origin"), **of(COUNT, "replicate"), **of(TEXT, "level suite"),
    **of(COUNT, "task config init_id"),
    **of(TEXT, "transition unresolved"),
    **{
        f"{condition}_{column}": type_
        for condition in ("nominal", *AXES, "simultaneous")
        for column, type_ in (("goal", NUMBER), ("steps", INTEGER))
    },
}  # fmt: skip

CELLS = {
    **of(TEXT, "level condition"), **of(COUNT, "shared missing quarantined"),
    **of(INTEGER, "n tasks"),
    **of(NUMBER, "s_a s_b difference difference_ci95_low difference_ci95_high"),
    **of(TEXT, "no_interval"), **of(INTEGER, "both a_only b_only neither"),
    **of(NUMBER, "mcnemar_p difference_worst difference_best"),
}  # fmt: skip


@dataclass(frozen=True)
class Report:
    """Results of campaigns and result files so far.

    Rates are fractions. The column `policy` holds the report's label of a policy: its name,
    followed by that of the campaign or file if several of these have a policy of that name."""

    #: The whole report, as `coordinator report --json` prints it.
    json: Mapping[str, Any] = field(repr=False)
    #: Warnings about reading several campaigns or files side by side.
    warnings: tuple[str, ...]
    #: Warnings about the figures of one policy, each after its label.
    notes: tuple[str, ...]
    #: A row per policy, level and condition (`nominal` at L0, each axis alone,
    #: `simultaneous`): successes of n rollouts, and rollouts without an outcome.
    success: pd.DataFrame = field(repr=False)
    #: A row per policy, level, condition and suite, and a row of all suites (`all`), whose rate has
    #: an interval about new tasks.
    suites: pd.DataFrame = field(repr=False)
    #: A row per policy and level: the protocol's paired measures with the ends of
    #: their 95 % intervals.
    paired: pd.DataFrame = field(repr=False)
    #: A row per policy, replicate, level and configuration, with all its outcomes.
    configurations: pd.DataFrame = field(repr=False)

    @property
    def emergent(self) -> pd.DataFrame:
        """Configurations that succeed under each axis alone and fail under all axes together."""
        return self._of_transition("emergent")

    @property
    def compensated(self) -> pd.DataFrame:
        """Configurations that fail under some axis alone and succeed under all axes together."""
        return self._of_transition("compensated")

    def _of_transition(self, name: str) -> pd.DataFrame:
        is_match = self.configurations["transition"].eq(name).fillna(False)
        rows: pd.DataFrame = self.configurations.loc[is_match].reset_index(drop=True)
        return rows


@dataclass(frozen=True)
class Comparison:
    """Comparison of two policies over the rollouts that both have. Differences are A - B."""

    #: The whole comparison, as `coordinator compare --json` prints it.
    json: Mapping[str, Any] = field(repr=False)
    #: Labels of the two policies.
    a: str
    b: str
    #: Warnings about the comparison.
    warnings: tuple[str, ...]
    #: Warnings about one policy, each after its label.
    notes: tuple[str, ...]
    #: A row per level and condition (`nominal` at L0, each axis, `simultaneous`).
    #: `difference_worst` and `difference_best` bound the difference for all possible outcomes of
    #: quarantined rollouts.
    cells: pd.DataFrame = field(repr=False)
    #: Rollouts that are not compared, because they differed between the two policies, by reason.
    unpaired: Mapping[str, tuple[str, ...]]


def report(connection: Connection, program: Program, sources: tuple[str | Path, ...]) -> Report:
    """Returns a report on campaigns (names) and result files (paths). Raises CoordinatorError."""
    _require_campaigns(connection, sources)
    types: dict[Any, Any] = defaultdict(lambda: OUTCOME, CONFIGURATIONS)
    with TemporaryDirectory(prefix="rollout-") as folder:
        table = Path(folder) / "configurations.csv"
        command = ("report", *map(_source, sources), "--json", "--table", table)
        text = program.run(*program.with_connection(*command))
        # Only empty cells are missing values: "NA" may be the name of a policy.
        rows = pd.read_csv(table, dtype=types, keep_default_na=False, na_values=[""])
    document = json.loads(text)
    return Report(
        json=document,
        warnings=tuple(document["warnings"]),
        notes=tuple(
            f"{subject['label']}: {note}"
            for subject in document["reports"]
            for note in subject["notes"]
        ),
        success=frames.frame(_success(document), SUCCESS),
        suites=frames.frame(_suites(document), SUITES),
        paired=frames.frame(_paired(document), PAIRED),
        configurations=rows,
    )


def compare(connection: Connection, program: Program, a: str | Path, b: str | Path) -> Comparison:
    """Returns the comparison of two campaigns (names) or result files (paths). Differences are
    A - B. Raises CoordinatorError."""
    _require_campaigns(connection, (a, b))
    command = ("compare", _source(a), _source(b), "--json")
    text = program.run(*program.with_connection(*command))
    document = json.loads(text)
    return Comparison(
        json=document,
        a=document["a"]["label"],
        b=document["b"]["label"],
        warnings=tuple(document["warnings"]),
        notes=tuple(document["notes"]),
        cells=frames.frame(map(_cell, document["cells"]), CELLS),
        unpaired={reason: tuple(ids) for reason, ids in document["unpaired"].items()},
    )


def _require_campaigns(connection: Connection, sources: tuple[str | Path, ...]) -> None:
    """Raises a typed error if a campaign does not exist: the program would only print a text."""
    for source in sources:
        if isinstance(source, str):
            connection.campaign(source)


def _source(source: str | Path) -> str:
    """Returns the argument for a source: paths have a `/`, which no campaign's name has."""
    text = str(source)
    return f"./{text}" if isinstance(source, Path) and "/" not in text else text


def _success(document: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for subject in document["reports"]:
        policy = subject["label"]
        if nominal := subject["nominal"]:
            counts = _counts(nominal["count"], nominal["gap"])
            yield {"policy": policy, "level": "L0", "condition": "nominal", **counts}
        for cell in subject["cells"]:
            gaps = cell["completeness"]["gaps"]
            conditions = {axis: alone["count"] for axis, alone in cell["alone"].items()}
            if cell["simultaneous"] is not None:
                conditions["simultaneous"] = cell["simultaneous"]
            for condition, count in conditions.items():
                counts = _counts(count, gaps.get(condition))
                yield {"policy": policy, "level": cell["level"], "condition": condition, **counts}


def _suites(document: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for subject in document["reports"]:
        for row in subject["success"]:
            names = {
                "policy": subject["label"], "level": row["level"], "condition": row["condition"]
            }  # fmt: skip
            for suite, count in row["suites"].items():
                yield {**names, "suite": suite, **_counts(count, None)}
            yield {**names, "suite": "all", **_counts(row["all"], None), **_ends(row, "")}


def _counts(count: Mapping[str, int], gap: Mapping[str, int] | None) -> dict[str, Any]:
    n = count["n"]
    gap = gap or {}
    return {
        **count,
        "rate": count["successes"] / n if n else None,
        "missing": gap.get("missing", 0),
        "quarantined": gap.get("quarantined", 0),
    }


def _paired(document: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for subject in document["reports"]:
        for cell in subject["cells"]:
            measures = cell["paired"]
            if measures is None:
                continue
            yield {
                "policy": subject["label"],
                "level": cell["level"],
                **measures,
                **{f"s_{axis}": rate for axis, rate in measures["s_axis"].items()},
                **{
                    end: value for name in INTERVALS for end, value in _ends(measures, name).items()
                },
            }


def _cell(cell: Mapping[str, Any]) -> dict[str, Any]:
    difference = cell["difference"] or {}
    worst, best = (cell["bounds"] or {}).get("difference", (None, None))
    return {
        **cell,
        "difference": None,
        **difference,
        **_ends(difference, "difference"),
        "difference_worst": worst,
        "difference_best": best,
    }


def _ends(measures: Mapping[str, Any], name: str) -> dict[str, float | None]:
    key = f"{name}_ci95".lstrip("_")
    low, high = measures.get(key) or (None, None)
    return {f"{key}_low": low, f"{key}_high": high}
