"""Status of a campaign, and a forecast of its duration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import datetime
from typing import Any

from . import frames


@dataclass(frozen=True)
class Status:
    """Status of a campaign, with the values that `coordinator campaign status --json` prints."""

    name: str
    #: The policy's name at its endpoint.
    policy: str
    #: URL of the gateway, or of the policy itself.
    endpoint: str
    #: Priority from -100 to 100; campaigns of higher priority run earlier.
    priority: int
    #: State: `running`, `paused` or `cancelled` by its operator, or `stopped` early by its stop
    #: rule.
    state: str
    #: True if the campaign cannot change by itself: it is cancelled or stopped, or every rollout is
    #: committed or quarantined and no further rollout can be created.
    is_finished: bool
    #: Counts of rollouts: all; waiting; running; with a result; with a result that reached the
    #: goal; with a result that did not; without a result after too many failures.
    total: int
    queued: int
    leased: int
    committed: int
    succeeded: int
    failed: int
    quarantined: int
    #: Rate of the rollouts that were committed within the last five minutes and started after the
    #: last resume, over these five minutes or the time since the first of them started; and time in
    #: which the remaining rollouts complete at that rate. None without such rollouts, or if the
    #: campaign is not running.
    rate_per_sec: float | None
    remaining_secs: float | None
    #: Number of live workers that can run the campaign.
    live_workers: int
    #: Reason why the campaign's policy is considered down; None if the policy is not down.
    policy_outage: str | None
    #: Reason why no rollout is running although some wait or will be created later.
    waiting_reason: str | None
    #: Description of the different fingerprints in the campaign's results; None unless there are
    #: several.
    mixed_fingerprints: str | None
    #: Stop rule, such as `width(I) < 0.08`, in which widths are fractions; None if there is none.
    stop_rule: str | None
    #: Number of configurations after which the campaign stopped early, and number of rollouts that
    #: did not run; None while it has not stopped.
    stopped_after: int | None
    saved: int | None
    #: Name of the campaign that this one explains or whose thresholds it measures, if any.
    follows_from: str | None
    created_at: datetime

    @classmethod
    def of(cls, answer: Mapping[str, Any]) -> Status:
        """Converts a coordinator's answer."""
        early = answer["early_stop"] or {}
        values = {
            **answer,
            **answer["rollouts"],
            "state": "running" if answer["state"] == "finished" else answer["state"],
            "stop_rule": early.get("rule"),
            "stopped_after": early.get("used"),
            "saved": early.get("saved"),
            "created_at": frames.instant(answer["created_at"]),
        }
        return cls(**{item.name: values[item.name] for item in fields(cls)})


#: Types of columns by the annotation of a field of Status.
COLUMNS = {
    "str": frames.TEXT, "str | None": frames.TEXT, "int": frames.COUNT,
    "int | None": frames.INTEGER, "bool": frames.FLAG, "float | None": frames.NUMBER,
    "datetime": frames.INSTANT,
}  # fmt: skip
CAMPAIGNS = {item.name: COLUMNS[str(item.type)] for item in fields(Status)}


@dataclass(frozen=True)
class Forecast:
    """The rollouts of a specification and their expected duration."""

    #: Rollouts per suite, replicates included.
    rollouts: Mapping[str, int]
    #: Number of live workers that can share a campaign, and number of their slots. If the workers
    #: form several groups that cannot share a campaign, only the one with the most slots is
    #: counted.
    workers: int
    slots: int
    #: Duration of all rollouts on these slots if they run nothing else; None if no rollout of the
    #: last seven days was measured on such a worker.
    secs: float | None
    #: Number of results of the last seven days from which the duration is computed; and True if
    #: they are results of this policy, False if they are results of other policies.
    results: int
    is_of_policy: bool
    #: Suites without such a result, which are assumed to be as fast as the other suites.
    unmeasured_suites: tuple[str, ...]
    #: Number of slots up to which more help on the workers' cores, as slots wait for the policy;
    #: None without such a result, or if a worker does not report its number of cores.
    useful_slots: int | None

    @property
    def total(self) -> int:
        """Number of all rollouts."""
        return sum(self.rollouts.values())

    @classmethod
    def of(cls, rollouts: Mapping[str, int], answer: Mapping[str, Any]) -> Forecast:
        """Converts a coordinator's answer."""
        suites = tuple(answer["unmeasured_suites"])
        return cls(rollouts=dict(rollouts), **{**answer, "unmeasured_suites": suites})
