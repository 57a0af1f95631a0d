from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class RegisterRequest(_message.Message):
    __slots__ = ("protocol_version", "program_version", "worker_id", "host", "slots", "asset_pack", "asset_pack_digest", "mujoco_version", "renderer", "cores", "machine", "look")
    PROTOCOL_VERSION_FIELD_NUMBER: _ClassVar[int]
    PROGRAM_VERSION_FIELD_NUMBER: _ClassVar[int]
    WORKER_ID_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    SLOTS_FIELD_NUMBER: _ClassVar[int]
    ASSET_PACK_FIELD_NUMBER: _ClassVar[int]
    ASSET_PACK_DIGEST_FIELD_NUMBER: _ClassVar[int]
    MUJOCO_VERSION_FIELD_NUMBER: _ClassVar[int]
    RENDERER_FIELD_NUMBER: _ClassVar[int]
    CORES_FIELD_NUMBER: _ClassVar[int]
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    LOOK_FIELD_NUMBER: _ClassVar[int]
    protocol_version: int
    program_version: str
    worker_id: str
    host: str
    slots: int
    asset_pack: str
    asset_pack_digest: str
    mujoco_version: str
    renderer: str
    cores: int
    machine: str
    look: str
    def __init__(self, protocol_version: _Optional[int] = ..., program_version: _Optional[str] = ..., worker_id: _Optional[str] = ..., host: _Optional[str] = ..., slots: _Optional[int] = ..., asset_pack: _Optional[str] = ..., asset_pack_digest: _Optional[str] = ..., mujoco_version: _Optional[str] = ..., renderer: _Optional[str] = ..., cores: _Optional[int] = ..., machine: _Optional[str] = ..., look: _Optional[str] = ...) -> None: ...

class RegisterResponse(_message.Message):
    __slots__ = ("protocol_version", "program_version", "lease_secs", "heartbeat_secs", "progress_timeout_secs", "idle_reason")
    PROTOCOL_VERSION_FIELD_NUMBER: _ClassVar[int]
    PROGRAM_VERSION_FIELD_NUMBER: _ClassVar[int]
    LEASE_SECS_FIELD_NUMBER: _ClassVar[int]
    HEARTBEAT_SECS_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_TIMEOUT_SECS_FIELD_NUMBER: _ClassVar[int]
    IDLE_REASON_FIELD_NUMBER: _ClassVar[int]
    protocol_version: int
    program_version: str
    lease_secs: float
    heartbeat_secs: float
    progress_timeout_secs: float
    idle_reason: str
    def __init__(self, protocol_version: _Optional[int] = ..., program_version: _Optional[str] = ..., lease_secs: _Optional[float] = ..., heartbeat_secs: _Optional[float] = ..., progress_timeout_secs: _Optional[float] = ..., idle_reason: _Optional[str] = ...) -> None: ...

class ClaimRequest(_message.Message):
    __slots__ = ("worker_id", "claim_id", "wait_secs", "warm_task", "lacking_tasks", "simulators")
    WORKER_ID_FIELD_NUMBER: _ClassVar[int]
    CLAIM_ID_FIELD_NUMBER: _ClassVar[int]
    WAIT_SECS_FIELD_NUMBER: _ClassVar[int]
    WARM_TASK_FIELD_NUMBER: _ClassVar[int]
    LACKING_TASKS_FIELD_NUMBER: _ClassVar[int]
    SIMULATORS_FIELD_NUMBER: _ClassVar[int]
    worker_id: str
    claim_id: str
    wait_secs: float
    warm_task: str
    lacking_tasks: _containers.RepeatedScalarFieldContainer[str]
    simulators: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, worker_id: _Optional[str] = ..., claim_id: _Optional[str] = ..., wait_secs: _Optional[float] = ..., warm_task: _Optional[str] = ..., lacking_tasks: _Optional[_Iterable[str]] = ..., simulators: _Optional[_Iterable[str]] = ...) -> None: ...

class ClaimResponse(_message.Message):
    __slots__ = ("lease", "idle_reason")
    LEASE_FIELD_NUMBER: _ClassVar[int]
    IDLE_REASON_FIELD_NUMBER: _ClassVar[int]
    lease: Lease
    idle_reason: str
    def __init__(self, lease: _Optional[_Union[Lease, _Mapping]] = ..., idle_reason: _Optional[str] = ...) -> None: ...

class Lease(_message.Message):
    __slots__ = ("attempt_id", "job_id", "attempt", "campaign", "replicate", "manifest_row", "policy_seed", "policy", "policy_endpoint", "realisation", "record_video", "record_failures_only", "keep_actions", "execution")
    ATTEMPT_ID_FIELD_NUMBER: _ClassVar[int]
    JOB_ID_FIELD_NUMBER: _ClassVar[int]
    ATTEMPT_FIELD_NUMBER: _ClassVar[int]
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    REPLICATE_FIELD_NUMBER: _ClassVar[int]
    MANIFEST_ROW_FIELD_NUMBER: _ClassVar[int]
    POLICY_SEED_FIELD_NUMBER: _ClassVar[int]
    POLICY_FIELD_NUMBER: _ClassVar[int]
    POLICY_ENDPOINT_FIELD_NUMBER: _ClassVar[int]
    REALISATION_FIELD_NUMBER: _ClassVar[int]
    RECORD_VIDEO_FIELD_NUMBER: _ClassVar[int]
    RECORD_FAILURES_ONLY_FIELD_NUMBER: _ClassVar[int]
    KEEP_ACTIONS_FIELD_NUMBER: _ClassVar[int]
    EXECUTION_FIELD_NUMBER: _ClassVar[int]
    attempt_id: str
    job_id: int
    attempt: int
    campaign: str
    replicate: int
    manifest_row: str
    policy_seed: int
    policy: str
    policy_endpoint: str
    realisation: str
    record_video: bool
    record_failures_only: bool
    keep_actions: bool
    execution: str
    def __init__(self, attempt_id: _Optional[str] = ..., job_id: _Optional[int] = ..., attempt: _Optional[int] = ..., campaign: _Optional[str] = ..., replicate: _Optional[int] = ..., manifest_row: _Optional[str] = ..., policy_seed: _Optional[int] = ..., policy: _Optional[str] = ..., policy_endpoint: _Optional[str] = ..., realisation: _Optional[str] = ..., record_video: bool = ..., record_failures_only: bool = ..., keep_actions: bool = ..., execution: _Optional[str] = ...) -> None: ...

class HeartbeatRequest(_message.Message):
    __slots__ = ("worker_id", "progress", "filming")
    WORKER_ID_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    FILMING_FIELD_NUMBER: _ClassVar[int]
    worker_id: str
    progress: _containers.RepeatedCompositeFieldContainer[Progress]
    filming: int
    def __init__(self, worker_id: _Optional[str] = ..., progress: _Optional[_Iterable[_Union[Progress, _Mapping]]] = ..., filming: _Optional[int] = ...) -> None: ...

class Progress(_message.Message):
    __slots__ = ("attempt_id", "control_steps")
    ATTEMPT_ID_FIELD_NUMBER: _ClassVar[int]
    CONTROL_STEPS_FIELD_NUMBER: _ClassVar[int]
    attempt_id: str
    control_steps: int
    def __init__(self, attempt_id: _Optional[str] = ..., control_steps: _Optional[int] = ...) -> None: ...

class HeartbeatResponse(_message.Message):
    __slots__ = ("lost_attempts",)
    LOST_ATTEMPTS_FIELD_NUMBER: _ClassVar[int]
    lost_attempts: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, lost_attempts: _Optional[_Iterable[str]] = ...) -> None: ...

class CommitRequest(_message.Message):
    __slots__ = ("attempt_id", "measurement", "motion")
    ATTEMPT_ID_FIELD_NUMBER: _ClassVar[int]
    MEASUREMENT_FIELD_NUMBER: _ClassVar[int]
    MOTION_FIELD_NUMBER: _ClassVar[int]
    attempt_id: str
    measurement: str
    motion: Motion
    def __init__(self, attempt_id: _Optional[str] = ..., measurement: _Optional[str] = ..., motion: _Optional[_Union[Motion, _Mapping]] = ...) -> None: ...

class Motion(_message.Message):
    __slots__ = ("path", "actions")
    PATH_FIELD_NUMBER: _ClassVar[int]
    ACTIONS_FIELD_NUMBER: _ClassVar[int]
    path: bytes
    actions: bytes
    def __init__(self, path: _Optional[bytes] = ..., actions: _Optional[bytes] = ...) -> None: ...

class GoalProgress(_message.Message):
    __slots__ = ("predicates", "at_end", "at_most")
    PREDICATES_FIELD_NUMBER: _ClassVar[int]
    AT_END_FIELD_NUMBER: _ClassVar[int]
    AT_MOST_FIELD_NUMBER: _ClassVar[int]
    predicates: int
    at_end: int
    at_most: int
    def __init__(self, predicates: _Optional[int] = ..., at_end: _Optional[int] = ..., at_most: _Optional[int] = ...) -> None: ...

class CommitResponse(_message.Message):
    __slots__ = ("verdict", "detail")
    class Verdict(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        VERDICT_UNSPECIFIED: _ClassVar[CommitResponse.Verdict]
        VERDICT_ACCEPTED: _ClassVar[CommitResponse.Verdict]
        VERDICT_DUPLICATE: _ClassVar[CommitResponse.Verdict]
        VERDICT_STALE: _ClassVar[CommitResponse.Verdict]
        VERDICT_DIVERGENT: _ClassVar[CommitResponse.Verdict]
        VERDICT_UNPAIRED: _ClassVar[CommitResponse.Verdict]
    VERDICT_UNSPECIFIED: CommitResponse.Verdict
    VERDICT_ACCEPTED: CommitResponse.Verdict
    VERDICT_DUPLICATE: CommitResponse.Verdict
    VERDICT_STALE: CommitResponse.Verdict
    VERDICT_DIVERGENT: CommitResponse.Verdict
    VERDICT_UNPAIRED: CommitResponse.Verdict
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    verdict: CommitResponse.Verdict
    detail: str
    def __init__(self, verdict: _Optional[_Union[CommitResponse.Verdict, str]] = ..., detail: _Optional[str] = ...) -> None: ...

class ReleaseRequest(_message.Message):
    __slots__ = ("attempt_id", "reason", "error", "answered_queries")
    class Reason(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        REASON_UNSPECIFIED: _ClassVar[ReleaseRequest.Reason]
        REASON_SIMULATOR_ERROR: _ClassVar[ReleaseRequest.Reason]
        REASON_SLOT_CRASHED: _ClassVar[ReleaseRequest.Reason]
        REASON_SLOT_STUCK: _ClassVar[ReleaseRequest.Reason]
        REASON_MACHINE_ERROR: _ClassVar[ReleaseRequest.Reason]
        REASON_POLICY_MISBEHAVED: _ClassVar[ReleaseRequest.Reason]
        REASON_POLICY_UNAVAILABLE: _ClassVar[ReleaseRequest.Reason]
        REASON_DRAINING: _ClassVar[ReleaseRequest.Reason]
    REASON_UNSPECIFIED: ReleaseRequest.Reason
    REASON_SIMULATOR_ERROR: ReleaseRequest.Reason
    REASON_SLOT_CRASHED: ReleaseRequest.Reason
    REASON_SLOT_STUCK: ReleaseRequest.Reason
    REASON_MACHINE_ERROR: ReleaseRequest.Reason
    REASON_POLICY_MISBEHAVED: ReleaseRequest.Reason
    REASON_POLICY_UNAVAILABLE: ReleaseRequest.Reason
    REASON_DRAINING: ReleaseRequest.Reason
    ATTEMPT_ID_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    ANSWERED_QUERIES_FIELD_NUMBER: _ClassVar[int]
    attempt_id: str
    reason: ReleaseRequest.Reason
    error: str
    answered_queries: int
    def __init__(self, attempt_id: _Optional[str] = ..., reason: _Optional[_Union[ReleaseRequest.Reason, str]] = ..., error: _Optional[str] = ..., answered_queries: _Optional[int] = ...) -> None: ...

class ReleaseResponse(_message.Message):
    __slots__ = ("verdict", "backoff_secs", "stop_leasing")
    class Verdict(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        VERDICT_UNSPECIFIED: _ClassVar[ReleaseResponse.Verdict]
        VERDICT_REQUEUED: _ClassVar[ReleaseResponse.Verdict]
        VERDICT_QUARANTINED: _ClassVar[ReleaseResponse.Verdict]
        VERDICT_STALE: _ClassVar[ReleaseResponse.Verdict]
    VERDICT_UNSPECIFIED: ReleaseResponse.Verdict
    VERDICT_REQUEUED: ReleaseResponse.Verdict
    VERDICT_QUARANTINED: ReleaseResponse.Verdict
    VERDICT_STALE: ReleaseResponse.Verdict
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    BACKOFF_SECS_FIELD_NUMBER: _ClassVar[int]
    STOP_LEASING_FIELD_NUMBER: _ClassVar[int]
    verdict: ReleaseResponse.Verdict
    backoff_secs: float
    stop_leasing: str
    def __init__(self, verdict: _Optional[_Union[ReleaseResponse.Verdict, str]] = ..., backoff_secs: _Optional[float] = ..., stop_leasing: _Optional[str] = ...) -> None: ...

class ArtifactChunk(_message.Message):
    __slots__ = ("attempt_id", "name", "data")
    ATTEMPT_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    attempt_id: str
    name: str
    data: bytes
    def __init__(self, attempt_id: _Optional[str] = ..., name: _Optional[str] = ..., data: _Optional[bytes] = ...) -> None: ...

class NextFilmRequest(_message.Message):
    __slots__ = ("asset_pack_digest", "mujoco_version", "look", "campaign")
    ASSET_PACK_DIGEST_FIELD_NUMBER: _ClassVar[int]
    MUJOCO_VERSION_FIELD_NUMBER: _ClassVar[int]
    LOOK_FIELD_NUMBER: _ClassVar[int]
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    asset_pack_digest: str
    mujoco_version: str
    look: str
    campaign: str
    def __init__(self, asset_pack_digest: _Optional[str] = ..., mujoco_version: _Optional[str] = ..., look: _Optional[str] = ..., campaign: _Optional[str] = ...) -> None: ...

class NextFilmResponse(_message.Message):
    __slots__ = ("film", "left")
    FILM_FIELD_NUMBER: _ClassVar[int]
    LEFT_FIELD_NUMBER: _ClassVar[int]
    film: Film
    left: int
    def __init__(self, film: _Optional[_Union[Film, _Mapping]] = ..., left: _Optional[int] = ...) -> None: ...

class Film(_message.Message):
    __slots__ = ("attempt_id", "campaign", "replicate", "manifest_row", "realisation", "actions", "success")
    ATTEMPT_ID_FIELD_NUMBER: _ClassVar[int]
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    REPLICATE_FIELD_NUMBER: _ClassVar[int]
    MANIFEST_ROW_FIELD_NUMBER: _ClassVar[int]
    REALISATION_FIELD_NUMBER: _ClassVar[int]
    ACTIONS_FIELD_NUMBER: _ClassVar[int]
    SUCCESS_FIELD_NUMBER: _ClassVar[int]
    attempt_id: str
    campaign: str
    replicate: int
    manifest_row: str
    realisation: str
    actions: bytes
    success: bool
    def __init__(self, attempt_id: _Optional[str] = ..., campaign: _Optional[str] = ..., replicate: _Optional[int] = ..., manifest_row: _Optional[str] = ..., realisation: _Optional[str] = ..., actions: _Optional[bytes] = ..., success: bool = ...) -> None: ...

class PutArtifactResponse(_message.Message):
    __slots__ = ("path",)
    PATH_FIELD_NUMBER: _ClassVar[int]
    path: str
    def __init__(self, path: _Optional[str] = ...) -> None: ...

class SignOffRequest(_message.Message):
    __slots__ = ("worker_id",)
    WORKER_ID_FIELD_NUMBER: _ClassVar[int]
    worker_id: str
    def __init__(self, worker_id: _Optional[str] = ...) -> None: ...

class SignOffResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Answer(_message.Message):
    __slots__ = ("json", "now_unix_ms")
    JSON_FIELD_NUMBER: _ClassVar[int]
    NOW_UNIX_MS_FIELD_NUMBER: _ClassVar[int]
    json: str
    now_unix_ms: int
    def __init__(self, json: _Optional[str] = ..., now_unix_ms: _Optional[int] = ...) -> None: ...

class CreateCampaignRequest(_message.Message):
    __slots__ = ("spec", "priority")
    SPEC_FIELD_NUMBER: _ClassVar[int]
    PRIORITY_FIELD_NUMBER: _ClassVar[int]
    spec: str
    priority: int
    def __init__(self, spec: _Optional[str] = ..., priority: _Optional[int] = ...) -> None: ...

class AppendRowsRequest(_message.Message):
    __slots__ = ("campaign", "rows", "spec")
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    ROWS_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    campaign: str
    rows: _containers.RepeatedCompositeFieldContainer[AppendedRow]
    spec: str
    def __init__(self, campaign: _Optional[str] = ..., rows: _Optional[_Iterable[_Union[AppendedRow, _Mapping]]] = ..., spec: _Optional[str] = ...) -> None: ...

class AppendedRow(_message.Message):
    __slots__ = ("manifest_row", "replicates")
    MANIFEST_ROW_FIELD_NUMBER: _ClassVar[int]
    REPLICATES_FIELD_NUMBER: _ClassVar[int]
    manifest_row: str
    replicates: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, manifest_row: _Optional[str] = ..., replicates: _Optional[_Iterable[int]] = ...) -> None: ...

class ListCampaignsRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class GetCampaignRequest(_message.Message):
    __slots__ = ("campaign",)
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    campaign: str
    def __init__(self, campaign: _Optional[str] = ...) -> None: ...

class ChangeCampaignRequest(_message.Message):
    __slots__ = ("campaign", "change")
    class Change(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        CHANGE_UNSPECIFIED: _ClassVar[ChangeCampaignRequest.Change]
        CHANGE_PAUSE: _ClassVar[ChangeCampaignRequest.Change]
        CHANGE_RESUME: _ClassVar[ChangeCampaignRequest.Change]
        CHANGE_CANCEL: _ClassVar[ChangeCampaignRequest.Change]
    CHANGE_UNSPECIFIED: ChangeCampaignRequest.Change
    CHANGE_PAUSE: ChangeCampaignRequest.Change
    CHANGE_RESUME: ChangeCampaignRequest.Change
    CHANGE_CANCEL: ChangeCampaignRequest.Change
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    CHANGE_FIELD_NUMBER: _ClassVar[int]
    campaign: str
    change: ChangeCampaignRequest.Change
    def __init__(self, campaign: _Optional[str] = ..., change: _Optional[_Union[ChangeCampaignRequest.Change, str]] = ...) -> None: ...

class DeleteCampaignRequest(_message.Message):
    __slots__ = ("campaign", "confirm")
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    CONFIRM_FIELD_NUMBER: _ClassVar[int]
    campaign: str
    confirm: str
    def __init__(self, campaign: _Optional[str] = ..., confirm: _Optional[str] = ...) -> None: ...

class JobName(_message.Message):
    __slots__ = ("rollout_id", "replicate")
    ROLLOUT_ID_FIELD_NUMBER: _ClassVar[int]
    REPLICATE_FIELD_NUMBER: _ClassVar[int]
    rollout_id: str
    replicate: int
    def __init__(self, rollout_id: _Optional[str] = ..., replicate: _Optional[int] = ...) -> None: ...

class ListJobsRequest(_message.Message):
    __slots__ = ("campaign", "state", "after_job_id", "limit", "outcome", "task", "condition", "level")
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    AFTER_JOB_ID_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    OUTCOME_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    CONDITION_FIELD_NUMBER: _ClassVar[int]
    LEVEL_FIELD_NUMBER: _ClassVar[int]
    campaign: str
    state: str
    after_job_id: int
    limit: int
    outcome: str
    task: str
    condition: str
    level: str
    def __init__(self, campaign: _Optional[str] = ..., state: _Optional[str] = ..., after_job_id: _Optional[int] = ..., limit: _Optional[int] = ..., outcome: _Optional[str] = ..., task: _Optional[str] = ..., condition: _Optional[str] = ..., level: _Optional[str] = ...) -> None: ...

class GetJobRequest(_message.Message):
    __slots__ = ("campaign", "job")
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    JOB_FIELD_NUMBER: _ClassVar[int]
    campaign: str
    job: JobName
    def __init__(self, campaign: _Optional[str] = ..., job: _Optional[_Union[JobName, _Mapping]] = ...) -> None: ...

class RetryJobsRequest(_message.Message):
    __slots__ = ("campaign", "jobs", "all")
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    JOBS_FIELD_NUMBER: _ClassVar[int]
    ALL_FIELD_NUMBER: _ClassVar[int]
    campaign: str
    jobs: _containers.RepeatedCompositeFieldContainer[JobName]
    all: bool
    def __init__(self, campaign: _Optional[str] = ..., jobs: _Optional[_Iterable[_Union[JobName, _Mapping]]] = ..., all: bool = ...) -> None: ...

class SkipJobsRequest(_message.Message):
    __slots__ = ("campaign", "jobs")
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    JOBS_FIELD_NUMBER: _ClassVar[int]
    campaign: str
    jobs: _containers.RepeatedCompositeFieldContainer[JobName]
    def __init__(self, campaign: _Optional[str] = ..., jobs: _Optional[_Iterable[_Union[JobName, _Mapping]]] = ...) -> None: ...

class ListWorkersRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class BackupRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class BackupChunk(_message.Message):
    __slots__ = ("data",)
    DATA_FIELD_NUMBER: _ClassVar[int]
    data: bytes
    def __init__(self, data: _Optional[bytes] = ...) -> None: ...

class ReportRequest(_message.Message):
    __slots__ = ("campaign",)
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    campaign: str
    def __init__(self, campaign: _Optional[str] = ...) -> None: ...

class ReportPart(_message.Message):
    __slots__ = ("json",)
    JSON_FIELD_NUMBER: _ClassVar[int]
    json: bytes
    def __init__(self, json: _Optional[bytes] = ...) -> None: ...

class ExportRequest(_message.Message):
    __slots__ = ("campaign",)
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    campaign: str
    def __init__(self, campaign: _Optional[str] = ...) -> None: ...

class ExportLine(_message.Message):
    __slots__ = ("json",)
    JSON_FIELD_NUMBER: _ClassVar[int]
    json: str
    def __init__(self, json: _Optional[str] = ...) -> None: ...

class ArchiveCampaignRequest(_message.Message):
    __slots__ = ("campaign",)
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    campaign: str
    def __init__(self, campaign: _Optional[str] = ...) -> None: ...

class ArchiveChunk(_message.Message):
    __slots__ = ("data",)
    DATA_FIELD_NUMBER: _ClassVar[int]
    data: bytes
    def __init__(self, data: _Optional[bytes] = ...) -> None: ...

class ImportChunk(_message.Message):
    __slots__ = ("name", "archive", "data")
    NAME_FIELD_NUMBER: _ClassVar[int]
    ARCHIVE_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    name: str
    archive: str
    data: bytes
    def __init__(self, name: _Optional[str] = ..., archive: _Optional[str] = ..., data: _Optional[bytes] = ...) -> None: ...

class AlterCampaignRequest(_message.Message):
    __slots__ = ("campaign", "priority", "policy_endpoint", "policy", "name")
    CAMPAIGN_FIELD_NUMBER: _ClassVar[int]
    PRIORITY_FIELD_NUMBER: _ClassVar[int]
    POLICY_ENDPOINT_FIELD_NUMBER: _ClassVar[int]
    POLICY_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    campaign: str
    priority: int
    policy_endpoint: str
    policy: str
    name: str
    def __init__(self, campaign: _Optional[str] = ..., priority: _Optional[int] = ..., policy_endpoint: _Optional[str] = ..., policy: _Optional[str] = ..., name: _Optional[str] = ...) -> None: ...

class ForecastRequest(_message.Message):
    __slots__ = ("policy", "rollouts")
    POLICY_FIELD_NUMBER: _ClassVar[int]
    ROLLOUTS_FIELD_NUMBER: _ClassVar[int]
    policy: str
    rollouts: _containers.RepeatedCompositeFieldContainer[SuiteRollouts]
    def __init__(self, policy: _Optional[str] = ..., rollouts: _Optional[_Iterable[_Union[SuiteRollouts, _Mapping]]] = ...) -> None: ...

class SuiteRollouts(_message.Message):
    __slots__ = ("suite", "rollouts")
    SUITE_FIELD_NUMBER: _ClassVar[int]
    ROLLOUTS_FIELD_NUMBER: _ClassVar[int]
    suite: str
    rollouts: int
    def __init__(self, suite: _Optional[str] = ..., rollouts: _Optional[int] = ...) -> None: ...
