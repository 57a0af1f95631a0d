"""Status of a campaign, and a forecast of its duration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import datetime
from typing import Any

from . import frames
from .proto import coordinator_pb2 as wire


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
class Speed:
    """Breakdown of a rollout's time, and the bottleneck of a campaign's rate."""

    #: Number of results with a breakdown of their time, from which the means are computed.
    results: int
    #: Mean seconds of one rollout: processor time of physics and of drawing, waiting time for the
    #: policy's answers, and the rest of its duration.
    physics_secs: float
    drawing_secs: float
    policy_secs: float
    waiting_secs: float
    #: Mean number of queries in a rollout.
    policy_queries: float
    #: `slots` (more slots would raise the rate), `cores` (all cores are busy) or `policy` (the
    #: policy's server is at its limit); None if a worker does not report its number of cores.
    bottleneck: str | None
    #: Smallest number of slots that reaches the highest rate on these cores with this policy, and
    #: the duration of all rollouts with that number of slots.
    enough_slots: int | None
    enough_slots_secs: float | None

    @classmethod
    def of(cls, message: wire.Speed) -> Speed:
        """Converts a coordinator's message."""
        bottleneck = wire.Speed.Bottleneck.Name(message.bottleneck)
        is_known = message.HasField("enough_slots")
        values = frames.fields(
            message,
            [item.name for item in fields(cls)],
            bottleneck=bottleneck.removeprefix("BOTTLENECK_").lower() if is_known else None,
            enough_slots_secs=message.enough_slots_secs if is_known else None,
        )
        return cls(**values)


@dataclass(frozen=True)
class Forecast:
    """The rollouts of a specification and their expected duration."""

    #: Rollouts per suite, replicates included.
    rollouts: Mapping[str, int]
    #: Number of live workers that can share a campaign, and number of their slots. If the workers
    #: form several groups that cannot share a campaign, only the group that would finish first is
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
    #: Number of cores that these slots share; None if a worker does not report its number of cores.
    cores: int | None
    #: Breakdown of a rollout's time, and bottleneck; None if no such result has a breakdown of its
    #: time.
    speed: Speed | None

    @property
    def total(self) -> int:
        """Number of all rollouts."""
        return sum(self.rollouts.values())

    @classmethod
    def of(cls, rollouts: Mapping[str, int], message: wire.ForecastResponse) -> Forecast:
        """Converts a coordinator's message."""
        values = frames.fields(
            message,
            [item.name for item in fields(cls)],
            rollouts=dict(rollouts),
            unmeasured_suites=tuple(message.unmeasured_suites),
            cores=message.cores or None,
            speed=Speed.of(message.speed) if message.HasField("speed") else None,
        )
        return cls(**values)
