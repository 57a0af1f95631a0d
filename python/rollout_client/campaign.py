"""One campaign of a coordinator."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from . import frames
from . import report as reports
from .connection import Connection
from .program import Program
from .proto import coordinator_pb2 as wire
from .report import Comparison, Report
from .status import Status

#: Jobs per request.
PAGE = 1_000

Change = wire.ChangeCampaignRequest


class Campaign:
    """A campaign, addressed by name. Every method queries the coordinator."""

    def __init__(self, name: str, connection: Connection, program: Program) -> None:
        self._name = name
        self._connection = connection
        self._program = program

    def __repr__(self) -> str:
        return f"Campaign({self._name!r}, {self._connection.access.url!r})"

    @property
    def name(self) -> str:
        """Name of the campaign, unique at its coordinator."""
        return self._name

    def status(self) -> Status:
        """Returns the campaign's status. Raises CoordinatorError, as all methods do."""
        return Status.of(self._connection.campaign(self._name))

    def spec(self) -> dict[str, Any]:
        """Returns the campaign's specification, as `Client.create` takes it."""
        request = wire.GetCampaignRequest(campaign=self._name)
        parts = self._connection.collect("GetSpecification", request)
        spec: dict[str, Any] = json.loads(b"".join(part.json for part in parts))
        return spec

    def follow(self, every: float = 2.0) -> Iterator[Status]:
        """Yields the status every `every` seconds until the campaign cannot change by itself.

        Ctrl-C (a notebook's interrupt) ends the iteration and leaves the campaign running."""
        try:
            while True:
                status = self.status()
                yield status
                if status.is_finished:
                    return
                time.sleep(every)
        except KeyboardInterrupt:
            return

    def results(self) -> pd.DataFrame:
        """Returns a row per committed rollout, sorted by rollout id and replicate. `axis` and
        `level` are the condition: `nominal` and `L0`, axes, `simultaneous` (all axes), or
        `variant` and `L0` (of LIBERO's family or a suite file). `config` is missing for nominal
        rollouts and variants, and only variants and tasks of suite files have `protocol` and
        `prompt`. Only rollouts with a displaced robot have `ik_res_mm`, the residual of the inverse
        kinematics, mm, and only rollouts of the placebo level have `placebo_radius`.
        `execution` is the execution model, `wait` unless the campaign or its row sets another.
        `goal_predicates` counts the goal's predicates, `goal_at_end` those that held at the end,
        and `goal_at_most` the largest number that held at one time."""
        request = wire.ExportRequest(campaign=self._name)
        lines = self._connection.collect("Export", request)
        rows = ({"execution": "wait", **json.loads(line.json)} for line in lines)
        return frames.frame(rows, frames.RESULTS)

    def jobs(
        self,
        *,
        state: str | None = None,
        outcome: str | None = None,
        task: str | None = None,
        condition: str | None = None,
        level: str | None = None,
    ) -> pd.DataFrame:
        """Returns a row per job, in the order of creation: in each replicate, all conditions of a
        configuration follow one another, except those that were added to the campaign later.

        state: `queued`, `leased`, `committed`, `quarantined`. outcome: `success`, `failure`. task:
        `libero_object/0`, or a suite. condition and level: as in rollout ids."""
        request = wire.ListJobsRequest(
            campaign=self._name,
            state=state or "",
            outcome=outcome or "",
            task=task or "",
            condition=condition or "",
            level=level or "",
            limit=PAGE,
        )
        rows: list[dict[str, Any]] = []
        while True:
            page = self._connection.call("ListJobs", request)
            rows += page
            if len(page) < PAGE:
                return frames.frame(rows, frames.JOBS)
            request.after_job_id = page[-1]["job_id"]

    def report(self) -> Report:
        """Returns the report on the campaign's results so far, which the program `coordinator`
        computes."""
        return reports.report(self._connection, self._program, (self._name,))

    def compare(self, other: Campaign | str | os.PathLike[str]) -> Comparison:
        """Returns the comparison of this campaign (A) with another campaign (B: a Campaign or its
        name), or with a result file or its folder (B: a Path). Differences are A - B. The program
        `coordinator` computes them."""
        source: str | Path = Path(other) if isinstance(other, os.PathLike) else _name(other)
        return reports.compare(self._connection, self._program, self._name, source)

    def pause(self) -> Status:
        """Stops leasing; rollouts that are running may still be committed."""
        return self._change(Change.CHANGE_PAUSE)

    def resume(self) -> Status:
        """Continues after a pause."""
        return self._change(Change.CHANGE_RESUME)

    def cancel(self) -> Status:
        """Ends the campaign permanently. Its results are kept."""
        return self._change(Change.CHANGE_CANCEL)

    def _change(self, change: wire.ChangeCampaignRequest.Change) -> Status:
        request = wire.ChangeCampaignRequest(campaign=self._name, change=change)
        self._connection.call("ChangeCampaign", request)
        return self.status()


def _name(campaign: Campaign | str) -> str:
    return campaign.name if isinstance(campaign, Campaign) else campaign
