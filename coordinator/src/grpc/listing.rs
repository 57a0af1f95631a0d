//! Conversion of jobs and workers to messages. Durations such as the age of a result are
//! computed here, since a client's clock may be wrong.

use proto::coordinator as wire;
use queue::clock::UnixMillis;
use queue::read::{FailureLine, JobDetails, JobLine, ResultLine, WorkerLine};

pub(super) fn job(line: JobLine, now: UnixMillis) -> wire::Job {
    let secs_until = |instant: Option<UnixMillis>| {
        instant.map_or(0.0, |instant| instant.since(now).as_secs_f64())
    };
    wire::Job {
        job_id: line.id.0,
        rollout_id: line.rollout_id,
        replicate: line.replicate,
        state: line.state,
        attempt: line.attempt.0,
        attempt_id: line.attempt_id.unwrap_or_default(),
        charged_attempts: line.charged_attempts,
        lease_owner: line.lease_owner.map(|owner| owner.0).unwrap_or_default(),
        lease_left_secs: secs_until(line.lease_expires_ms),
        control_steps: line.control_steps.unwrap_or(0),
        backoff_left_secs: secs_until(line.not_before_ms),
        last_error: line.last_error.unwrap_or_default(),
        success: line.success,
        steps: line.steps,
    }
}

pub(super) fn details(details: JobDetails, now: UnixMillis) -> wire::GetJobResponse {
    let failure = |line: FailureLine| wire::Failure {
        attempt: line.attempt.0,
        worker_id: line.worker_id.0,
        ago_secs: now.since(line.failed_ms).as_secs_f64(),
        reason: line.reason,
        charged: line.charged,
        error: line.error,
        failed_unix_ms: line.failed_ms.0,
    };
    let result = |line: ResultLine| wire::ResultOrigin {
        goal: Some(wire::GoalProgress {
            predicates: line.goal_predicates,
            at_end: line.goal_at_end,
            at_most: line.goal_at_most,
        }),
        attempt: line.number.0,
        worker_id: line.worker_id.0,
        ago_secs: now.since(line.committed_ms).as_secs_f64(),
        wall_secs: line.wall_secs,
        host: line.provenance.host,
        look: line.provenance.pin.look.to_string(),
        renderer: line.provenance.pin.renderer,
        divergences: line.divergences,
        video: line.video.unwrap_or_default(),
        prompt: line.prompt.unwrap_or_default(),
        committed_unix_ms: line.committed_ms.0,
    };
    wire::GetJobResponse {
        job: Some(job(details.line, now)),
        manifest_row: details.manifest_row,
        stale_reports: details.stale_reports,
        failures: details.failures.into_iter().map(failure).collect(),
        result: details.result.map(result),
    }
}

pub(super) fn worker(line: WorkerLine, now: UnixMillis) -> wire::WorkerStatus {
    wire::WorkerStatus {
        worker_id: line.id.0,
        host: line.host,
        slots: line.slots,
        leases: line.leases,
        asset_pack: line.asset_pack,
        mujoco_version: line.mujoco_version,
        renderer: line.renderer,
        look: line.look,
        program_version: line.program_version,
        silent_secs: now.since(line.last_seen_ms).as_secs_f64(),
        alive: line.is_alive,
        charged_in_a_row: line.charged_in_a_row,
        stopped_reason: line.stopped_reason.unwrap_or_default(),
        filming: line.filming,
        last_seen_unix_ms: line.last_seen_ms.0,
        registered_unix_ms: line.registered_ms.0,
        signed_off: line.has_signed_off,
    }
}
