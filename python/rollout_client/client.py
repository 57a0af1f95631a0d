"""Python client of a coordinator."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from . import access, frames
from . import report as reports
from .campaign import Campaign
from .connection import Connection
from .errors import SettingsError
from .program import Program
from .proto import coordinator_pb2 as wire
from .report import Comparison, Report
from .status import CAMPAIGNS, Forecast, Status

#: A specification (docs/PROTOCOL.md): its fields, or the path of a JSON file.
Spec = Mapping[str, Any] | str | os.PathLike[str]

#: A row of a manifest (docs/PROTOCOL.md).
Row = Mapping[str, Any]


class Client:
    """The campaigns of a coordinator.

    It connects at the first call. All methods raise CoordinatorError."""

    def __init__(
        self,
        url: str | None = None,
        *,
        token_file: str | os.PathLike[str] | None = None,
        ca: str | os.PathLike[str] | None = None,
        retry_secs: float = 30.0,
        program: str | os.PathLike[str] | None = None,
    ) -> None:
        """url: `http://HOST:PORT`, or with TLS `https://HOST:PORT`; by default COORDINATOR_URL,
        else port 7411 of this machine. token_file: lines `ROLE TOKEN` of an operator or a viewer;
        by default ROLLOUT_TOKEN_FILE, or such lines in ROLLOUT_TOKENS. ca: the certificate
        authority, PEM; by default ROLLOUT_CA. retry_secs: time to keep trying if the coordinator
        does not answer. program: the program `coordinator`, for reports; by default the first on
        PATH."""
        settings = access.read(url, token_file, ca)
        self._connection = Connection(settings, retry_secs)
        self._program = Program(program, settings)

    def __repr__(self) -> str:
        return f"Client({self._connection.access.url!r})"

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection."""
        self._connection.close()

    def campaigns(self) -> pd.DataFrame:
        """Returns a row per campaign, oldest first, with the fields of Status."""
        answer = self._connection.call("ListCampaigns", wire.ListCampaignsRequest())
        statuses = map(Status.of, answer)
        return frames.frame(map(asdict, statuses), CAMPAIGNS)

    def campaign(self, name: str) -> Campaign:
        """Returns an existing campaign."""
        campaign = Campaign(name, self._connection, self._program)
        campaign.status()
        return campaign

    def create(
        self, spec: Spec, *, rows: Iterable[Row] | None = None, priority: int = 0
    ) -> Campaign:
        """Creates a campaign. Creating it again with the same specification returns the same
        campaign; another specification under its name is refused.

        rows: rows to run unchanged, in place of a design in `spec`. priority: from -100 to 100;
        rollouts of higher priority are leased earlier."""
        text = _text(spec)
        if rows is not None:
            text = json.dumps({**json.loads(text), "rows": list(rows)})
        request = wire.CreateCampaignRequest(spec=text, priority=priority)
        self._connection.call("CreateCampaign", request)
        return Campaign(json.loads(text)["name"], self._connection, self._program)

    def append(self, campaign: str, rows: Iterable[Row]) -> int:
        """Adds rows to a campaign of rows, all or none; rows that it has are ignored. A finished
        campaign runs again. Returns the number of new rollouts."""
        appended = [wire.AppendedRow(manifest_row=json.dumps(row)) for row in rows]
        request = wire.AppendRowsRequest(campaign=campaign, rows=appended)
        added: int = self._connection.call("AppendRows", request)["jobs_added"]
        return added

    def forecast(self, spec: Spec) -> Forecast:
        """Returns the number of rollouts that `create` would create, and the time that the
        currently connected workers would take. Creates nothing."""
        text = _text(spec)
        rows = self._program.run("manifest", "--spec", "-", text=text).splitlines()
        suites = Counter(json.loads(row)["suite"] for row in rows)
        fields = json.loads(text)
        replicates = fields.get("replicates", 1)
        rollouts = {suite: count * replicates for suite, count in sorted(suites.items())}
        request = wire.ForecastRequest(
            policy=fields["policy"]["name"],
            rollouts=[
                wire.SuiteRollouts(suite=suite, rollouts=count) for suite, count in rollouts.items()
            ],
        )
        answer = self._connection.call("Forecast", request)
        return Forecast.of(rollouts, answer)

    def gate(
        self,
        policies: str | Sequence[str],
        against: str,
        *,
        conditions: Sequence[str] = ("nominal",),
        margin: float = 2.0,
        budget: int | None = None,
        endpoint: str | None = None,
        name: str | None = None,
    ) -> dict[str, Any]:
        """Has connected workers run rollouts of a policy, or of checkpoints in the order of their
        training, until it is known whether its success is lower than that of the finished campaign
        `against` by more than `margin` points. Returns the JSON of `coordinator gate`
        (docs/JSON.md): each decision has a `verdict`, `not_worse`, `worse`, or `undecided` within
        `budget` rollouts. Raises RefusedError if the policies cannot be compared."""
        names = [policies] if isinstance(policies, str) else policies
        flags = ["--policy", ",".join(names), "--against", against, "--margin", str(margin)]
        flags += ["--conditions", ",".join(conditions), "--json"]
        for flag, value in (("--budget", budget), ("--endpoint", endpoint), ("--name", name)):
            if value is not None:
                flags += [flag, str(value)]
        answer = self._program.run(
            *self._program.with_connection("gate", *flags), codes=(0, 1, 2)
        )
        decided: dict[str, Any] = json.loads(answer)
        return decided

    def workers(self) -> pd.DataFrame:
        """Returns a row per worker, including workers that have ended, latest calls first; at most
        1,000 rows."""
        answer = self._connection.call("ListWorkers", wire.ListWorkersRequest())
        return frames.frame(answer, frames.WORKERS)

    def report(self, *sources: str | os.PathLike[str]) -> Report:
        """Returns one report on several campaigns (names) and result files or
        their folders (paths), side by side."""
        return reports.report(self._connection, self._program, tuple(map(_source, sources)))

    def compare(self, a: str | os.PathLike[str], b: str | os.PathLike[str]) -> Comparison:
        """Returns the comparison of two campaigns (names), or result files or their folders
        (paths), over the rollouts that both have. Differences are A - B."""
        return reports.compare(self._connection, self._program, _source(a), _source(b))


def _source(source: str | os.PathLike[str]) -> str | Path:
    return source if isinstance(source, str) else Path(source)


def _text(spec: Spec) -> str:
    """Returns a specification as JSON. Raises SettingsError."""
    if isinstance(spec, Mapping):
        return json.dumps(spec)
    path = Path(spec)
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8"
        raise SettingsError(f"failed to read specification {path}: {reason}") from error
