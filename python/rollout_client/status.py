"""How a campaign stands, and how long one would take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import datetime

from . import frames
from .proto import coordinator_pb2 as wire


@dataclass(frozen=True)
class Status:
    """How a campaign stands, as `coordinator campaign status --json` says it."""

    name: str
    #: The policy's name at its endpoint.
    policy: str
    #: URL of the gateway, or of the policy itself.
    endpoint: str
    #: From -100 to 100; the higher, the earlier.
    priority: int
    #: What its operator made of it: `running`, `paused`, `cancelled`; or `stopped`, early, as
    #: its rule says.
    state: str
    #: Nothing more will happen by itself: it is cancelled or stopped, or every rollout is
    #: committed or quarantined and none may follow.
    is_finished: bool
    #: Rollouts that there are; that wait, are being run, have a result; of these, that reached
    #: their goal and did not; and that failed too often and have none.
    total: int
    queued: int
    leased: int
    committed: int
    succeeded: int
    failed: int
    quarantined: int
    #: Rollouts per second of late, and seconds that the rest takes at that rate; None until
    #: one is committed, and unless the campaign is running.
    rate_per_sec: float | None
    remaining_secs: float | None
    #: Workers alive that can run it.
    live_workers: int
    #: Why its policy is taken to be down.
    policy_outage: str | None
    #: Why nothing is running although rollouts wait, or are still to follow.
    waiting_reason: str | None
    #: How its results mix fingerprints, if they have several.
    mixed_fingerprints: str | None
    #: When it ends early, such as `width(I) < 0.08`; None if it runs to its end.
    stop_rule: str | None
    #: After so many of its configurations it stopped early, and so many rollouts that saved;
    #: None while it has not.
    stopped_after: int | None
    saved: int | None
    #: The campaign from whose outcomes its rollouts follow, if they do.
    follows_from: str | None
    created_at: datetime

    @classmethod
    def of(cls, message: wire.CampaignStatus) -> Status:
        """As a coordinator sent it."""
        state = wire.CampaignStatus.State.Name(message.state).removeprefix("STATE_").lower()
        is_settled = message.committed + message.quarantined >= message.total
        is_complete = is_settled and not message.may_grow
        early = message.early_stop
        has_stopped = early.HasField("used")
        has_rate, has_eta = message.HasField("rate_per_sec"), message.HasField("eta_secs")
        return cls(
            name=message.campaign,
            policy=message.policy,
            endpoint=message.policy_endpoint,
            priority=message.priority,
            state=state,
            is_finished=state in ("cancelled", "stopped") or is_complete,
            total=message.total,
            queued=message.queued,
            leased=message.leased,
            committed=message.committed,
            succeeded=message.succeeded,
            failed=message.committed - message.succeeded,
            quarantined=message.quarantined,
            rate_per_sec=message.rate_per_sec if has_rate else None,
            remaining_secs=message.eta_secs if has_eta else None,
            live_workers=message.live_workers,
            policy_outage=message.policy_pause_reason if message.policy_paused else None,
            waiting_reason=message.waiting_reason or None,
            mixed_fingerprints=message.mixed_fingerprints or None,
            stop_rule=early.rule or None,
            stopped_after=early.used if has_stopped else None,
            saved=message.queued if has_stopped else None,
            follows_from=message.follows_from or None,
            created_at=frames.instant(message.created_unix_ms),
        )


#: A status as a row.
COLUMNS = {
    "str": frames.TEXT,
    "str | None": frames.TEXT,
    "int": frames.COUNT,
    "int | None": frames.INTEGER,
    "bool": frames.FLAG,
    "float | None": frames.NUMBER,
    "datetime": frames.INSTANT,
}
CAMPAIGNS = {item.name: COLUMNS[str(item.type)] for item in fields(Status)}


@dataclass(frozen=True)
class Speed:
    """What a rollout's time goes into, and what a campaign's rate is bound by."""

    #: Results that say where their time went.
    results: int
    #: Mean seconds of one rollout: processor time of physics and drawing, until the policy
    #: had answered, and what these leave of its duration.
    physics_secs: float
    drawing_secs: float
    policy_secs: float
    waiting_secs: float
    #: Mean number of queries in a rollout.
    policy_queries: float
    #: `slots` (more of them make it faster), `cores` (all are busy) or `policy` (its server
    #: answers no faster); None where a worker does not say how many cores it has.
    bottleneck: str | None
    #: The fewest slots that are as fast as any number on these cores and with this policy,
    #: and the seconds that they would take.
    enough_slots: int | None
    enough_slots_secs: float | None

    @classmethod
    def of(cls, message: wire.Speed) -> Speed:
        """As a coordinator sent it."""
        bottleneck = wire.Speed.Bottleneck.Name(message.bottleneck)
        is_known = message.HasField("enough_slots")
        return cls(
            results=message.results,
            physics_secs=message.physics_secs,
            drawing_secs=message.drawing_secs,
            policy_secs=message.policy_secs,
            waiting_secs=message.waiting_secs,
            policy_queries=message.policy_queries,
            bottleneck=bottleneck.removeprefix("BOTTLENECK_").lower() if is_known else None,
            enough_slots=message.enough_slots if is_known else None,
            enough_slots_secs=message.enough_slots_secs if is_known else None,
        )


@dataclass(frozen=True)
class Forecast:
    """What a specification would make, and how long it would take."""

    #: Rollouts of each suite, replicates included.
    rollouts: Mapping[str, int]
    #: The workers alive that run alike, and their slots.
    workers: int
    slots: int
    #: Seconds that they take together, if they run nothing else; None where no rollout was
    #: measured on such a worker of late.
    secs: float | None
    #: Recent results that this rests on, and whether they are of this policy; else they are
    #: of others.
    results: int
    is_of_policy: bool
    #: Suites without such a result, taken to be as fast as the others.
    unmeasured_suites: tuple[str, ...]
    #: Cores that those slots share; None where a worker does not say.
    cores: int | None
    #: What bounds it; None where no such result says where its time went.
    speed: Speed | None

    @property
    def total(self) -> int:
        """All rollouts."""
        return sum(self.rollouts.values())

    @classmethod
    def of(cls, rollouts: Mapping[str, int], message: wire.ForecastResponse) -> Forecast:
        """As a coordinator sent it."""
        return cls(
            rollouts=dict(rollouts),
            workers=message.workers,
            slots=message.slots,
            secs=message.secs if message.HasField("secs") else None,
            results=message.results,
            is_of_policy=message.is_of_policy,
            unmeasured_suites=tuple(message.unmeasured_suites),
            cores=message.cores or None,
            speed=Speed.of(message.speed) if message.HasField("speed") else None,
        )
