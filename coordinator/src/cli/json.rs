//! Output of `--json`. The schema is documented in docs/JSON.md, and a test compares the two.
//! Fields may be added but never changed or removed. Absent values are `null`; every key is always
//! present.

use proto::coordinator as wire;
use queue::clock::{UnixMillis, rfc3339};
use serde::Serialize;
use serde_json::Value;

use super::command::{CommandError, failure, print_line};

/// Declares structs of the output with their conversions from messages, so that each key is written
/// once.
macro_rules! forms {
    ($($name:ident from $value:ident: $from:ty {
        $($key:ident: $type:ty = $expression:expr,)*
    })*) => {$(
        #[derive(Serialize)]
        pub(super) struct $name {
            $($key: $type,)*
        }

        impl $name {
            pub(super) fn from_message($value: &$from) -> $name {
                $name { $($key: $expression,)* }
            }
        }
    )*};
}
pub(super) use forms;

/// Output of `jobs list`.
#[derive(Serialize)]
pub(super) struct Jobs {
    pub(super) jobs: Vec<Job>,
    /// True if `--limit` cut the list off.
    pub(super) is_truncated: bool,
}

/// Output of `jobs show`.
#[derive(Serialize)]
pub(super) struct JobDetails {
    job: Job,
    manifest_row: Value,
    late_reports: u32,
    result: Option<ResultOrigin>,
    failures: Vec<Failure>,
}

/// Output of `workers`.
#[derive(Serialize)]
pub(super) struct Workers {
    workers: Vec<Worker>,
}

forms! {
    Job from job: wire::Job {
        rollout_id: String = job.rollout_id.clone(),
        replicate: u32 = job.replicate,
        job_id: i64 = job.job_id,
        state: String = job.state.clone(),
        outcome: Option<&'static str> =
            job.success.map(|success| if success { "success" } else { "failure" }),
        steps: Option<u32> = job.steps,
        attempts: u32 = job.attempt,
        charged_attempts: u32 = job.charged_attempts,
        attempt_id: Option<String> = non_empty(&job.attempt_id),
        worker_id: Option<String> = non_empty(&job.lease_owner),
        control_steps: Option<u32> = (job.state == "leased").then_some(job.control_steps),
        lease_left_secs: Option<f64> = (job.state == "leased").then_some(job.lease_left_secs),
        backoff_left_secs: Option<f64> = (job.state == "queued").then_some(job.backoff_left_secs),
        last_error: Option<String> = non_empty(&job.last_error),
    }

    ResultOrigin from result: wire::ResultOrigin {
        goal: Option<Goal> = result.goal.as_ref().map(Goal::from_message),
        prompt: Option<String> = non_empty(&result.prompt),
        attempt: u32 = result.attempt,
        worker_id: String = result.worker_id.clone(),
        host: String = result.host.clone(),
        renderer: String = result.renderer.clone(),
        look: String = result.look.clone(),
        wall_secs: f64 = result.wall_secs,
        divergences: u32 = result.divergences,
        video: Option<String> = non_empty(&result.video),
        committed_at: String = instant(result.committed_unix_ms),
    }

    Goal from goal: wire::GoalProgress {
        predicates: u32 = goal.predicates,
        at_end: u32 = goal.at_end,
        at_most: u32 = goal.at_most,
    }

    Failure from failure: wire::Failure {
        attempt: u32 = failure.attempt,
        worker_id: String = failure.worker_id.clone(),
        reason: String = failure.reason.clone(),
        is_charged: bool = failure.charged,
        error: String = failure.error.clone(),
        failed_at: String = instant(failure.failed_unix_ms),
    }

    Worker from worker: wire::WorkerStatus {
        worker_id: String = worker.worker_id.clone(),
        host: String = worker.host.clone(),
        slots: u32 = worker.slots,
        leases: u32 = worker.leases,
        asset_pack: String = worker.asset_pack.clone(),
        mujoco_version: String = worker.mujoco_version.clone(),
        renderer: String = worker.renderer.clone(),
        look: String = worker.look.clone(),
        program_version: String = worker.program_version.clone(),
        is_alive: bool = worker.alive,
        has_signed_off: bool = worker.signed_off,
        failures_in_a_row: u32 = worker.charged_in_a_row,
        stopped_reason: Option<String> = non_empty(&worker.stopped_reason),
        registered_at: String = instant(worker.registered_unix_ms),
        last_call_at: String = instant(worker.last_seen_unix_ms),
    }
}

/// Prints an answer as indented JSON.
pub(super) fn print(answer: &impl Serialize) -> Result<(), CommandError> {
    let text = serde_json::to_string_pretty(answer).map_err(failure)?;
    Ok(print_line(&text)?)
}

fn non_empty(text: &str) -> Option<String> {
    (!text.is_empty()).then(|| text.to_owned())
}

fn instant(unix_ms: i64) -> String {
    rfc3339::text(UnixMillis(unix_ms))
}

impl JobDetails {
    pub(super) fn from_message(details: &wire::GetJobResponse) -> Result<JobDetails, CommandError> {
        Ok(JobDetails {
            job: Job::from_message(&details.job.clone().unwrap_or_default()),
            manifest_row: serde_json::from_str(&details.manifest_row).map_err(failure)?,
            late_reports: details.stale_reports,
            result: details.result.as_ref().map(ResultOrigin::from_message),
            failures: details.failures.iter().map(Failure::from_message).collect(),
        })
    }
}

impl Workers {
    pub(super) fn from_messages<'a>(
        workers: impl Iterator<Item = &'a wire::WorkerStatus>,
    ) -> Workers {
        Workers { workers: workers.map(Worker::from_message).collect() }
    }
}
