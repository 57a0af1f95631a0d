//! Output of `--json`. The schema is documented in docs/JSON.md, and a test compares the two.
//! Fields may be added but never changed or removed. Absent values are `null`; every key is always
//! present.

use coordinator::words::rfc3339;
use proto::coordinator as wire;
use proto::coordinator::campaign_status::State;
use queue::clock::UnixMillis;
use serde::Serialize;
use serde_json::Value;

use super::command::{CommandError, failure, print_line};
use super::line::is_finished;

/// `campaign list` and `campaign status`.
#[derive(Serialize)]
pub(super) struct Campaigns {
    campaigns: Vec<Campaign>,
}

/// `jobs list`.
#[derive(Serialize)]
pub(super) struct Jobs {
    pub(super) jobs: Vec<Job>,
    /// True if `--limit` cut the list off.
    pub(super) is_truncated: bool,
}

/// `jobs show`.
#[derive(Serialize)]
pub(super) struct JobDetails {
    job: Job,
    manifest_row: Value,
    late_reports: u32,
    result: Option<ResultOrigin>,
    failures: Vec<Failure>,
}

/// `workers`.
#[derive(Serialize)]
pub(super) struct Workers {
    workers: Vec<Worker>,
}

#[derive(Serialize)]
struct Campaign {
    name: String,
    policy: String,
    endpoint: String,
    priority: i32,
    state: &'static str,
    is_finished: bool,
    rollouts: Rollouts,
    rate_per_sec: Option<f64>,
    remaining_secs: Option<f64>,
    live_workers: u32,
    policy_outage: Option<String>,
    waiting_reason: Option<String>,
    mixed_fingerprints: Option<String>,
    early_stop: Option<EarlyStop>,
    follows_from: Option<String>,
    created_at: String,
}

#[derive(Serialize)]
struct EarlyStop {
    rule: String,
    seed: u64,
    strata: String,
    configurations: u32,
    used: Option<u32>,
    saved: Option<u64>,
}

#[derive(Serialize)]
struct Rollouts {
    total: u64,
    queued: u64,
    leased: u64,
    committed: u64,
    succeeded: u64,
    failed: u64,
    quarantined: u64,
}

#[derive(Serialize)]
pub(super) struct Job {
    rollout_id: String,
    replicate: u32,
    job_id: i64,
    state: String,
    outcome: Option<&'static str>,
    steps: Option<u32>,
    attempts: u32,
    charged_attempts: u32,
    attempt_id: Option<String>,
    worker_id: Option<String>,
    control_steps: Option<u32>,
    lease_left_secs: Option<f64>,
    backoff_left_secs: Option<f64>,
    last_error: Option<String>,
}

#[derive(Serialize)]
struct Goal {
    predicates: u32,
    at_end: u32,
    at_most: u32,
}

#[derive(Serialize)]
struct ResultOrigin {
    goal: Option<Goal>,
    attempt: u32,
    worker_id: String,
    host: String,
    renderer: String,
    wall_secs: f64,
    divergences: u32,
    video: Option<String>,
    committed_at: String,
}

#[derive(Serialize)]
struct Failure {
    attempt: u32,
    worker_id: String,
    reason: String,
    is_charged: bool,
    error: String,
    failed_at: String,
}

#[derive(Serialize)]
struct Worker {
    worker_id: String,
    host: String,
    slots: u32,
    leases: u32,
    asset_pack: String,
    mujoco_version: String,
    renderer: String,
    program_version: String,
    is_alive: bool,
    has_signed_off: bool,
    failures_in_a_row: u32,
    stopped_reason: Option<String>,
    registered_at: String,
    last_call_at: String,
}

/// Prints an answer as indented JSON.
pub(super) fn print(answer: &impl Serialize) -> Result<(), CommandError> {
    let text = serde_json::to_string_pretty(answer).map_err(failure)?;
    Ok(print_line(&text)?)
}

fn given(text: &str) -> Option<String> {
    (!text.is_empty()).then(|| text.to_owned())
}

fn instant(unix_ms: i64) -> String {
    rfc3339(UnixMillis(unix_ms))
}

impl Campaigns {
    pub(super) fn of(statuses: &[wire::CampaignStatus]) -> Campaigns {
        Campaigns {
            campaigns: statuses.iter().map(Campaign::of).collect(),
        }
    }
}

impl Campaign {
    fn of(status: &wire::CampaignStatus) -> Campaign {
        Campaign {
            name: status.campaign.clone(),
            policy: status.policy.clone(),
            endpoint: status.policy_endpoint.clone(),
            priority: status.priority,
            state: match status.state() {
                State::Running | State::Unspecified => "running",
                State::Paused => "paused",
                State::Cancelled => "cancelled",
                State::Stopped => "stopped",
            },
            is_finished: is_finished(status),
            rollouts: Rollouts {
                total: status.total,
                queued: status.queued,
                leased: status.leased,
                committed: status.committed,
                succeeded: status.succeeded,
                failed: status.committed.saturating_sub(status.succeeded),
                quarantined: status.quarantined,
            },
            rate_per_sec: status.rate_per_sec,
            remaining_secs: status.eta_secs,
            live_workers: status.live_workers,
            policy_outage: status
                .policy_paused
                .then(|| status.policy_pause_reason.clone()),
            waiting_reason: given(&status.waiting_reason),
            mixed_fingerprints: given(&status.mixed_fingerprints),
            early_stop: status.early_stop.as_ref().map(|early| EarlyStop {
                rule: early.rule.clone(),
                seed: early.seed,
                strata: early.strata.clone(),
                configurations: early.configurations,
                used: early.used,
                saved: early.used.map(|_| status.queued),
            }),
            follows_from: given(&status.follows_from),
            created_at: instant(status.created_unix_ms),
        }
    }
}

impl Job {
    pub(super) fn of(job: &wire::Job) -> Job {
        let is_leased = job.state == "leased";
        Job {
            rollout_id: job.rollout_id.clone(),
            replicate: job.replicate,
            job_id: job.job_id,
            state: job.state.clone(),
            outcome: job
                .success
                .map(|success| if success { "success" } else { "failure" }),
            steps: job.steps,
            attempts: job.attempt,
            charged_attempts: job.charged_attempts,
            attempt_id: given(&job.attempt_id),
            worker_id: given(&job.lease_owner),
            control_steps: is_leased.then_some(job.control_steps),
            lease_left_secs: is_leased.then_some(job.lease_left_secs),
            backoff_left_secs: (job.state == "queued").then_some(job.backoff_left_secs),
            last_error: given(&job.last_error),
        }
    }
}

impl JobDetails {
    /// # Errors
    /// If the manifest row is not valid JSON.
    pub(super) fn of(details: &wire::GetJobResponse) -> Result<JobDetails, CommandError> {
        let failures = details.failures.iter().map(|failure| Failure {
            attempt: failure.attempt,
            worker_id: failure.worker_id.clone(),
            reason: failure.reason.clone(),
            is_charged: failure.charged,
            error: failure.error.clone(),
            failed_at: instant(failure.failed_unix_ms),
        });
        let result = details.result.as_ref().map(|result| ResultOrigin {
            attempt: result.attempt,
            worker_id: result.worker_id.clone(),
            host: result.host.clone(),
            renderer: result.renderer.clone(),
            wall_secs: result.wall_secs,
            divergences: result.divergences,
            video: given(&result.video),
            committed_at: instant(result.committed_unix_ms),
            goal: result.goal.as_ref().map(|goal| Goal {
                predicates: goal.predicates,
                at_end: goal.at_end,
                at_most: goal.at_most,
            }),
        });
        Ok(JobDetails {
            job: Job::of(&details.job.clone().unwrap_or_default()),
            manifest_row: serde_json::from_str(&details.manifest_row).map_err(failure)?,
            late_reports: details.stale_reports,
            result,
            failures: failures.collect(),
        })
    }
}

impl Workers {
    pub(super) fn of<'a>(workers: impl Iterator<Item = &'a wire::WorkerStatus>) -> Workers {
        let worker = |worker: &wire::WorkerStatus| Worker {
            worker_id: worker.worker_id.clone(),
            host: worker.host.clone(),
            slots: worker.slots,
            leases: worker.leases,
            asset_pack: worker.asset_pack.clone(),
            mujoco_version: worker.mujoco_version.clone(),
            renderer: worker.renderer.clone(),
            program_version: worker.program_version.clone(),
            is_alive: worker.alive,
            has_signed_off: worker.signed_off,
            failures_in_a_row: worker.charged_in_a_row,
            stopped_reason: given(&worker.stopped_reason),
            registered_at: instant(worker.registered_unix_ms),
            last_call_at: instant(worker.last_seen_unix_ms),
        };
        Workers {
            workers: workers.map(worker).collect(),
        }
    }
}
