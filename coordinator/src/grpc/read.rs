//! Reading messages: every string is bounded, every number in range, every
//! digest a digest, before it goes any further.

use proto::{MAX_MOTION_STEPS, coordinator as wire};
use tonic::Status;

use crate::campaign::Change;
use crate::digests::{AxisDigests, AxisDigestsError, is_sha256};
use crate::ids::{Attempt, JobId, LeaseRef, WorkerId, shortened};
use crate::lease::FailureReason;
use crate::queue::{CommitReport, JobName, MAX_JOBS_RETRIED, Retry};
use crate::store::motions::Motion;
use crate::store::results::{Digests, Outcome, Provenance};
use crate::store::workers::{Pin, WorkerInfo};

/// Longest name or version that is kept, bytes.
const MAX_TEXT_BYTES: usize = 512;
/// Longest rollout id that is looked for, bytes.
const MAX_ROLLOUT_ID_BYTES: usize = 128;
/// Longest error message that is kept, bytes; the rest is cut off.
const MAX_ERROR_BYTES: usize = 4_096;
/// A point of a path: three numbers of 16 bits.
const POINT_BYTES: usize = 6;
const MAX_PATH_BYTES: usize = (MAX_MOTION_STEPS + 1) * POINT_BYTES;
/// An action: seven numbers of 32 bits.
const ACTION_BYTES: usize = 28;
const MAX_ACTIONS_BYTES: usize = MAX_MOTION_STEPS * ACTION_BYTES;

pub(super) fn worker_id(id: &str) -> Result<WorkerId, Status> {
    WorkerId::parse(id).map_err(|error| Status::invalid_argument(error.to_string()))
}

pub(super) fn lease(lease: Option<wire::LeaseRef>) -> Result<LeaseRef, Status> {
    let lease = lease.ok_or_else(|| missing("lease"))?;
    Ok(LeaseRef {
        worker: worker_id(&lease.worker_id)?,
        job: JobId(lease.job_id),
        attempt: Attempt(lease.attempt),
    })
}

pub(super) fn worker_info(request: wire::RegisterRequest) -> Result<WorkerInfo, Status> {
    if request.slots == 0 {
        return Err(Status::invalid_argument("`slots` is 0; a worker has some"));
    }
    Ok(WorkerInfo {
        id: worker_id(&request.worker_id)?,
        host: text("host", request.host)?,
        slots: request.slots,
        asset_pack: required("asset_pack", request.asset_pack)?,
        asset_pack_digest: required("asset_pack_digest", request.asset_pack_digest)?,
        mujoco_version: required("mujoco_version", request.mujoco_version)?,
        renderer: required("renderer", request.renderer)?,
        program_version: text("program_version", request.program_version)?,
    })
}

/// What a film is made with. The pack's name says nothing here, nor does the
/// renderer: a film is to look at, and in no comparison.
pub(super) fn pin(request: wire::NextFilmRequest) -> Result<Pin, Status> {
    Ok(Pin {
        asset_pack: String::new(),
        asset_pack_digest: required("asset_pack_digest", request.asset_pack_digest)?,
        mujoco_version: required("mujoco_version", request.mujoco_version)?,
        renderer: String::new(),
    })
}

pub(super) fn commit(request: wire::CommitRequest) -> Result<CommitReport, Status> {
    let provenance = request.provenance.ok_or_else(|| missing("provenance"))?;
    Ok(CommitReport {
        motion: motion(request.motion.unwrap_or_default())?,
        lease: lease(request.lease)?,
        outcome: outcome(request.outcome.ok_or_else(|| missing("outcome"))?)?,
        digests: Digests {
            scene: digest("scene_digest", &provenance.scene_digest)?,
            init_state: digest("init_state_digest", &provenance.init_state_digest)?,
            perturbation: axis_digests(&provenance.perturbation_digest)?,
            first_frame: digest_or_empty("first_frame_digest", &provenance.first_frame_digest)?,
        },
        provenance: Provenance {
            host: text("host", provenance.host)?,
            renderer: required("renderer", provenance.renderer)?,
            fingerprint: digest("fingerprint", &provenance.fingerprint)?,
            mujoco_version: required("mujoco_version", provenance.mujoco_version)?,
            asset_pack: required("asset_pack", provenance.asset_pack)?,
            asset_pack_digest: required("asset_pack_digest", provenance.asset_pack_digest)?,
            realisation: realisation(&provenance.realisation)?,
            policy_name: required("policy_name", provenance.policy_name)?,
            policy_checkpoint: text("policy_checkpoint", provenance.policy_checkpoint)?,
            policy_checkpoint_digest: text(
                "policy_checkpoint_digest",
                provenance.policy_checkpoint_digest,
            )?,
            policy_privileged: provenance.policy_privileged,
            policy_canonical_only: provenance.policy_canonical_only,
            batch_mode: text("batch_mode", provenance.batch_mode)?,
            program_version: text("program_version", provenance.program_version)?,
        },
    })
}

pub(super) fn change(change: i32) -> Result<Change, Status> {
    use wire::change_campaign_request::Change as Wire;
    match Wire::try_from(change) {
        Ok(Wire::Pause) => Ok(Change::Pause),
        Ok(Wire::Resume) => Ok(Change::Resume),
        Ok(Wire::Cancel) => Ok(Change::Cancel),
        Ok(Wire::Unspecified) | Err(_) => Err(Status::invalid_argument(format!(
            "`change` is {change}, which is none of this protocol version"
        ))),
    }
}

/// The name of a job's state; none where all are wanted.
pub(super) fn job_state(state: &str) -> Result<Option<&str>, Status> {
    match state {
        "" => Ok(None),
        "queued" | "leased" | "committed" | "quarantined" => Ok(Some(state)),
        other => Err(Status::invalid_argument(format!(
            "`{}` is no state of a job; there are queued, leased, committed, quarantined",
            shortened(other, MAX_ROLLOUT_ID_BYTES)
        ))),
    }
}

pub(super) fn job_name(name: wire::JobName) -> Result<JobName, Status> {
    if name.rollout_id.len() > MAX_ROLLOUT_ID_BYTES {
        return Err(Status::invalid_argument(format!(
            "a rollout id is longer than {MAX_ROLLOUT_ID_BYTES} bytes"
        )));
    }
    Ok(JobName {
        rollout_id: required("rollout_id", name.rollout_id)?,
        replicate: name.replicate,
    })
}

pub(super) fn retry(jobs: Vec<wire::JobName>, all: bool) -> Result<Retry, Status> {
    match (all, jobs.len()) {
        (true, 0) => Ok(Retry::All),
        (false, 1..=MAX_JOBS_RETRIED) => {
            let names: Result<Vec<JobName>, Status> = jobs.into_iter().map(job_name).collect();
            Ok(Retry::Named(names?))
        }
        _ => Err(Status::invalid_argument(format!(
            "name 1 to {MAX_JOBS_RETRIED} jobs, or ask for all"
        ))),
    }
}

pub(super) fn failure_reason(reason: i32) -> Result<FailureReason, Status> {
    use wire::release_request::Reason;
    match Reason::try_from(reason) {
        Ok(Reason::SimulatorError) => Ok(FailureReason::SimulatorError),
        Ok(Reason::SlotCrashed) => Ok(FailureReason::SlotCrashed),
        Ok(Reason::SlotStuck) => Ok(FailureReason::SlotStuck),
        Ok(Reason::PolicyMisbehaved) => Ok(FailureReason::PolicyMisbehaved),
        Ok(Reason::PolicyUnavailable) => Ok(FailureReason::PolicyUnavailable),
        Ok(Reason::Draining) => Ok(FailureReason::Draining),
        Ok(Reason::Unspecified) | Err(_) => Err(Status::invalid_argument(format!(
            "`reason` is {reason}, which is none of this protocol version"
        ))),
    }
}

/// An error message, cut to what is kept; never empty, because a quarantined
/// job must say something.
pub(super) fn error_text(error: &str) -> &str {
    match shortened(error, MAX_ERROR_BYTES).trim() {
        "" => "no reason was given",
        error => error,
    }
}

/// Seconds of a wait; what is not a sensible number waits not at all.
pub(super) fn wait(secs: f64) -> std::time::Duration {
    std::time::Duration::try_from_secs_f64(secs).unwrap_or_default()
}

fn motion(motion: wire::Motion) -> Result<Motion, Status> {
    let (path, actions) = (motion.path.len(), motion.actions.len());
    if path > MAX_PATH_BYTES || !path.is_multiple_of(POINT_BYTES) {
        return Err(Status::invalid_argument(format!(
            "`motion.path` has {path} bytes: {POINT_BYTES} for each control step, and at most \
             {MAX_PATH_BYTES}"
        )));
    }
    if actions > MAX_ACTIONS_BYTES || !actions.is_multiple_of(ACTION_BYTES) {
        return Err(Status::invalid_argument(format!(
            "`motion.actions` has {actions} bytes: {ACTION_BYTES} for each control step, and at \
             most {MAX_ACTIONS_BYTES}"
        )));
    }
    Ok(Motion {
        path: motion.path,
        actions: motion.actions,
    })
}

fn outcome(outcome: wire::Outcome) -> Result<Outcome, Status> {
    let residuals = [outcome.ik_residual_mm, outcome.ik_residual_deg];
    let finite = |value: &f64| value.is_finite() && *value >= 0.0;
    if !finite(&outcome.wall_secs) || !residuals.iter().flatten().all(finite) {
        return Err(Status::invalid_argument(
            "`outcome` holds a number that is negative or not finite",
        ));
    }
    Ok(Outcome {
        success: outcome.success,
        steps: outcome.steps,
        wall_secs: outcome.wall_secs,
        ik_residual_mm: outcome.ik_residual_mm,
        ik_residual_deg: outcome.ik_residual_deg,
        ik_clamped_joints: outcome.ik_clamped_joints,
        clipped_actions: outcome.clipped_actions,
        policy_queries: outcome.policy_queries,
    })
}

fn realisation(name: &str) -> Result<String, Status> {
    name.parse::<protocol::Realisation>()
        .map(|realisation| realisation.to_string())
        .map_err(|error| Status::invalid_argument(error.to_string()))
}

fn text(field: &str, value: String) -> Result<String, Status> {
    if value.len() > MAX_TEXT_BYTES {
        return Err(Status::invalid_argument(format!(
            "`{field}` is longer than {MAX_TEXT_BYTES} bytes"
        )));
    }
    Ok(value)
}

fn required(field: &str, value: String) -> Result<String, Status> {
    if value.is_empty() {
        return Err(missing(field));
    }
    text(field, value)
}

fn digest(field: &str, value: &str) -> Result<String, Status> {
    if is_sha256(value) {
        Ok(value.to_owned())
    } else {
        Err(Status::invalid_argument(format!(
            "`{field}` is not a SHA-256 in lower-case hex"
        )))
    }
}

fn digest_or_empty(field: &str, value: &str) -> Result<String, Status> {
    if value.is_empty() {
        return Ok(String::new());
    }
    digest(field, value)
}

fn axis_digests(value: &str) -> Result<AxisDigests, Status> {
    value.parse().map_err(|error: AxisDigestsError| {
        Status::invalid_argument(format!("`perturbation_digest`: {error}"))
    })
}

fn missing(field: &str) -> Status {
    Status::invalid_argument(format!("`{field}` is missing"))
}
