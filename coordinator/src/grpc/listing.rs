//! Conversion of campaigns, jobs and workers to messages. Durations such as the age of a result are
//! computed here, since a client's clock may be wrong.

use proto::coordinator as wire;
use queue::clock::UnixMillis;
use queue::read::{
    CampaignStatus, EarlyStop, FailureLine, JobDetails, JobLine, ResultLine, WorkerLine,
};
use queue::rules::campaign::CampaignState;

pub(super) fn status(status: CampaignStatus) -> wire::CampaignStatus {
    let (campaign, counts) = (status.campaign, status.counts);
    wire::CampaignStatus {
        campaign: campaign.name.as_str().to_owned(),
        policy: campaign.policy,
        policy_endpoint: campaign.endpoint,
        total: counts.total(),
        queued: counts.queued,
        leased: counts.leased,
        committed: counts.committed,
        quarantined: counts.quarantined,
        succeeded: counts.succeeded,
        policy_paused: status.policy_pause_reason.is_some(),
        policy_pause_reason: status.policy_pause_reason.unwrap_or_default(),
        policy_retry_secs: status.policy_retry.map(|retry| retry.as_secs_f64()),
        rate_per_sec: status.rate_per_sec,
        eta_secs: status.eta_secs,
        live_workers: status.live_workers,
        waiting_reason: status.waiting_reason,
        mixed_fingerprints: status
            .fingerprints
            .map_or_else(String::new, |mixed| ::report::describe_fingerprints(&mixed)),
        state: state(campaign.state).into(),
        priority: campaign.priority,
        created_unix_ms: campaign.created_ms.0,
        early_stop: status.stop.map(early_stop),
        follows_from: status.source.map_or_else(String::new, |source| source.to_string()),
    }
}

fn early_stop(early: EarlyStop) -> wire::campaign_status::EarlyStop {
    wire::campaign_status::EarlyStop {
        rule: early.stop.rule.to_string(),
        seed: early.stop.seed,
        strata: early.stop.strata.name().to_owned(),
        configurations: early.configurations,
        used: early.used,
    }
}

pub(super) fn state(state: CampaignState) -> wire::campaign_status::State {
    use wire::campaign_status::State;
    match state {
        CampaignState::Running { .. } => State::Running,
        CampaignState::Paused { .. } => State::Paused,
        CampaignState::Cancelled { .. } => State::Cancelled,
        CampaignState::Stopped { .. } => State::Stopped,
    }
}

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
            predicates: line.outcome.goal.predicates,
            at_end: line.outcome.goal.at_end,
            at_most: line.outcome.goal.at_most,
        }),
        attempt: line.number.0,
        worker_id: line.worker_id.0,
        ago_secs: now.since(line.committed_ms).as_secs_f64(),
        wall_secs: line.outcome.wall_secs,
        host: line.provenance.host,
        look: line.provenance.pin.look.to_string(),
        renderer: line.provenance.pin.renderer,
        divergences: line.divergences,
        video: line.video.unwrap_or_default(),
        prompt: line.outcome.0.prompt.unwrap_or_default(),
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
