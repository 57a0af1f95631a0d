//! Validation of request messages: strings are bounded and free of terminal control sequences,
//! numbers are within range, and digests are well-formed.

use std::borrow::Cow;
use std::collections::BTreeMap;

use libero_ctrl::{Axis, JsonError, Look, Suite, select_tasks};
use proto::{MAX_MOTION_STEPS, MAX_TEXT_BYTES, coordinator as wire};
use queue::ids::{CampaignName, JobId, JobName, WorkerId, shortened};
use queue::read::JobFilter;
use queue::rules::campaign::{Change, PRIORITIES};
use queue::rules::lease::FailureReason;
use queue::{
    Alteration, AppendedRow, CommitReport, MAX_JOBS_RETRIED, MAX_SLOTS, Retry, WorkerInfo,
};
use rollout_types::{
    AttemptId, Digests, GoalProgress, IkResidual, Motion, Parts, Pin, Provenance, Realised,
    RolloutResult,
};
use terminal::printable;
use tonic::Status;

use super::failure::invalid;

/// Longest accepted rollout id, bytes.
const MAX_ROLLOUT_ID_BYTES: usize = 128;
/// Longest stored error message, bytes; longer ones are truncated.
const MAX_ERROR_BYTES: usize = 4_096;
/// Longest stored prompt of a policy, bytes; longer ones are truncated.
const MAX_PROMPT_BYTES: usize = 4_096;
/// Longest path and actions of a motion, bytes: 6 per position and 28 per action.
const MAX_PATH_BYTES: usize = (MAX_MOTION_STEPS + 1) * 6;
const MAX_ACTIONS_BYTES: usize = MAX_MOTION_STEPS * 28;
/// Largest measurement of a result, in seconds, millimetres or degrees; bounded so that sums stay
/// finite.
const MAX_MEASURED: f64 = 1e9;
/// Most values of one realised axis; the metric axes, which have numeric parameters, have at most a
/// few dozen.
const MAX_REALISED_VALUES: usize = 1_024;

pub(super) fn worker_id(id: &str) -> Result<WorkerId, Status> {
    WorkerId::parse(id).map_err(invalid)
}

pub(super) fn attempt(id: &str) -> Result<AttemptId, Status> {
    id.parse().map_err(invalid)
}

/// Clamps the reported number of films in progress to the maximum number of slots of a worker.
pub(super) fn filming(count: u32) -> u32 {
    count.min(MAX_SLOTS)
}

/// Accepts a claim id, which has the format of an attempt id.
pub(super) fn claim_id(id: String) -> Result<String, Status> {
    let read = id.parse::<AttemptId>().map(|_| id);
    read.map_err(|_| invalid("`claim_id` is not 32 digits of lower-case hex"))
}

pub(super) fn worker_info(request: wire::RegisterRequest) -> Result<WorkerInfo, Status> {
    if request.slots == 0 {
        return Err(invalid("`slots` is 0; a worker has at least one"));
    }
    for (field, count) in [("slots", request.slots), ("cores", request.cores)] {
        if count > MAX_SLOTS {
            return Err(invalid(format!(
                "`{field}` is {count}; a worker may have at most {MAX_SLOTS}"
            )));
        }
    }
    Ok(WorkerInfo {
        id: worker_id(&request.worker_id)?,
        host: text("host", request.host)?,
        slots: request.slots,
        cores: (request.cores > 0).then_some(request.cores),
        machine: Some(text("machine", request.machine)?).filter(|machine| !machine.is_empty()),
        pin: Pin {
            asset_pack: required("asset_pack", request.asset_pack)?,
            asset_pack_digest: required("asset_pack_digest", request.asset_pack_digest)?,
            mujoco_version: required("mujoco_version", request.mujoco_version)?,
            renderer: required("renderer", request.renderer)?,
            look: look(&request.look)?,
        },
        program_version: text("program_version", request.program_version)?,
    })
}

/// Reads the asset pack digest, simulator version and look of a film worker. The pack's name and the
/// renderer do not matter, since films are for viewing and never compared.
pub(super) fn pin(request: wire::NextFilmRequest) -> Result<Pin, Status> {
    Ok(Pin {
        asset_pack_digest: required("asset_pack_digest", request.asset_pack_digest)?,
        mujoco_version: required("mujoco_version", request.mujoco_version)?,
        look: look(&request.look)?,
        ..Pin::default()
    })
}

pub(super) fn commit(request: wire::CommitRequest) -> Result<CommitReport, Status> {
    let provenance = request.provenance.ok_or_else(|| missing("provenance"))?;
    Ok(CommitReport {
        motion: motion(request.motion.unwrap_or_default())?,
        attempt: attempt(&request.attempt_id)?,
        result: result(request.result.ok_or_else(|| missing("result"))?)?,
        realised: realised(provenance.realised)?,
        digests: Digests {
            scene: digest("scene_digest", &provenance.scene_digest)?,
            init_state: digest("init_state_digest", &provenance.init_state_digest)?,
            first_frame: digest_or_empty("first_frame_digest", &provenance.first_frame_digest)?,
        },
        provenance: Provenance {
            host: text("host", provenance.host)?,
            pin: Pin {
                asset_pack: required("asset_pack", provenance.asset_pack)?,
                asset_pack_digest: required("asset_pack_digest", provenance.asset_pack_digest)?,
                mujoco_version: required("mujoco_version", provenance.mujoco_version)?,
                renderer: required("renderer", provenance.renderer)?,
                look: look(&provenance.look)?,
            },
            fingerprint: digest("fingerprint", &provenance.fingerprint)?,
            realisation: realisation(&provenance.realisation)?,
            policy_name: required("policy_name", provenance.policy_name)?,
            policy_checkpoint: text("policy_checkpoint", provenance.policy_checkpoint)?,
            policy_checkpoint_digest: text(
                "policy_checkpoint_digest",
                provenance.policy_checkpoint_digest,
            )?,
            policy_privileged: provenance.policy_privileged,
            policy_canonical_only: provenance.policy_canonical_only,
            policy_settings: settings(provenance.policy_settings)?,
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
        Ok(Wire::Unspecified) | Err(_) => Err(invalid(format!(
            "`change` is {change}, which this protocol version does not define"
        ))),
    }
}

/// Accepts a priority within [`PRIORITIES`].
pub(super) fn priority(priority: i32) -> Result<i32, Status> {
    if PRIORITIES.contains(&priority) {
        return Ok(priority);
    }
    let (least, most) = (PRIORITIES.start(), PRIORITIES.end());
    Err(invalid(format!("`priority` is {priority}; it must be from {least} to {most}")))
}

pub(super) fn alteration(request: wire::AlterCampaignRequest) -> Result<Alteration, Status> {
    let name = request.name.map(|name| CampaignName::parse(&name));
    let endpoint = request.policy_endpoint;
    let policy = request.policy;
    Ok(Alteration {
        priority: request.priority.map(priority).transpose()?,
        endpoint: endpoint.map(|endpoint| required("policy_endpoint", endpoint)).transpose()?,
        policy: policy.map(|policy| required("policy", policy)).transpose()?,
        name: name.transpose().map_err(invalid)?,
    })
}

/// Returns the number of rollouts by suite.
pub(super) fn rollouts_by_suite(
    requests: Vec<wire::SuiteRollouts>,
) -> Result<BTreeMap<String, u64>, Status> {
    let mut rollouts = BTreeMap::new();
    for requested in requests {
        if requested.suite != Suite::Own.name() {
            let _: Suite = requested.suite.parse().map_err(invalid)?;
        }
        let total: &mut u64 = rollouts.entry(requested.suite).or_default();
        *total = total.saturating_add(requested.rollouts);
    }
    Ok(rollouts)
}

/// Reads the filters of `ListJobs`.
pub(super) fn job_filter(request: &wire::ListJobsRequest) -> Result<JobFilter<'_>, Status> {
    let non_empty = |text: &'_ str| (!text.is_empty()).then(|| text.to_owned());
    let condition = non_empty(&request.condition).map(|name| name.parse());
    let level = non_empty(&request.level).map(|name| name.parse());
    let task = request.task.as_str();
    if !task.is_empty() {
        select_tasks(task).map_err(invalid)?;
    }
    Ok(JobFilter {
        state: job_state(&request.state)?,
        success: match request.outcome.as_str() {
            "" => None,
            "success" => Some(true),
            "failure" => Some(false),
            other => {
                return Err(invalid(format!(
                    "`{}` is not an outcome; write success or failure",
                    shortened(other, MAX_ROLLOUT_ID_BYTES)
                )));
            }
        },
        task: (!task.is_empty() && task != "all").then_some(task),
        condition: condition.transpose().map_err(invalid)?,
        level: level.transpose().map_err(invalid)?,
        after: JobId(request.after_job_id),
        limit: request.limit,
    })
}

/// Reads a job state; the empty string selects all states.
fn job_state(state: &str) -> Result<Option<&str>, Status> {
    match state {
        "" => Ok(None),
        "queued" | "leased" | "committed" | "quarantined" => Ok(Some(state)),
        other => Err(invalid(format!(
            "`{}` is not a job state; the states are queued, leased, committed, quarantined",
            shortened(other, MAX_ROLLOUT_ID_BYTES)
        ))),
    }
}

pub(super) fn job_name(name: wire::JobName) -> Result<JobName, Status> {
    if name.rollout_id.len() > MAX_ROLLOUT_ID_BYTES {
        return Err(invalid(format!("a rollout id is longer than {MAX_ROLLOUT_ID_BYTES} bytes")));
    }
    Ok(JobName { rollout_id: required("rollout_id", name.rollout_id)?, replicate: name.replicate })
}

pub(super) fn retry(jobs: Vec<wire::JobName>, all: bool) -> Result<Retry, Status> {
    match (all, jobs.len()) {
        (true, 0) => Ok(Retry::All),
        (false, 1..=MAX_JOBS_RETRIED) => {
            let names: Result<Vec<JobName>, Status> = jobs.into_iter().map(job_name).collect();
            Ok(Retry::Named(names?))
        }
        _ => Err(invalid(format!("name 1 to {MAX_JOBS_RETRIED} jobs, or set `all`"))),
    }
}

/// Reads the rows to be added to a campaign.
pub(super) fn rows(rows: Vec<wire::AppendedRow>) -> Result<Vec<AppendedRow>, Status> {
    let read = |(index, row): (usize, wire::AppendedRow)| {
        let unreadable = |error| {
            let problem = JsonError::from(error);
            invalid(format!("read row {} of the added rows: {}", index + 1, problem.problem()))
        };
        let replicates = row.replicates;
        let row = serde_json::from_str(&row.manifest_row).map_err(unreadable)?;
        Ok(AppendedRow { row, replicates })
    };
    rows.into_iter().enumerate().map(read).collect()
}

/// Reads the names of 1 to [`MAX_JOBS_RETRIED`] jobs.
pub(super) fn job_names(jobs: Vec<wire::JobName>) -> Result<Vec<JobName>, Status> {
    match jobs.len() {
        1..=MAX_JOBS_RETRIED => jobs.into_iter().map(job_name).collect(),
        _ => Err(invalid(format!("name 1 to {MAX_JOBS_RETRIED} jobs"))),
    }
}

pub(super) fn failure_reason(reason: i32) -> Result<FailureReason, Status> {
    use wire::release_request::Reason;
    match Reason::try_from(reason) {
        Ok(Reason::SimulatorError) => Ok(FailureReason::SimulatorError),
        Ok(Reason::MachineError) => Ok(FailureReason::MachineError),
        Ok(Reason::SlotCrashed) => Ok(FailureReason::SlotCrashed),
        Ok(Reason::SlotStuck) => Ok(FailureReason::SlotStuck),
        Ok(Reason::PolicyMisbehaved) => Ok(FailureReason::PolicyMisbehaved),
        Ok(Reason::PolicyUnavailable) => Ok(FailureReason::PolicyUnavailable),
        Ok(Reason::Draining) => Ok(FailureReason::Draining),
        Ok(Reason::Unspecified) | Err(_) => Err(invalid(format!(
            "`reason` is {reason}, which this protocol version does not define"
        ))),
    }
}

/// Truncates an error message and makes it printable. An empty message is replaced by a
/// placeholder, since a quarantined job must show a reason.
pub(super) fn error_text(error: &str) -> Cow<'_, str> {
    match shortened(error, MAX_ERROR_BYTES).trim() {
        "" => "no reason was given".into(),
        error => printable(error),
    }
}

/// Converts seconds to a duration; zero if negative, not finite or too large.
pub(super) fn wait(secs: f64) -> std::time::Duration {
    std::time::Duration::try_from_secs_f64(secs).unwrap_or_default()
}

fn motion(motion: wire::Motion) -> Result<Motion, Status> {
    let wire::Motion { path, actions } = motion;
    let motion = Motion { path, actions };
    let (path, actions) = (motion.path.len(), motion.actions.len());
    if !motion.is_whole() || path > MAX_PATH_BYTES || actions > MAX_ACTIONS_BYTES {
        return Err(invalid(format!(
            "`motion` has {path} bytes of path and {actions} bytes of actions; it may have 6 bytes \
             per position, at most {MAX_PATH_BYTES}, and 28 bytes per action, at most \
             {MAX_ACTIONS_BYTES}"
        )));
    }
    Ok(motion)
}

fn result(result: wire::RolloutResult) -> Result<RolloutResult, Status> {
    let residuals = [result.ik_residual_mm, result.ik_residual_deg];
    let fits = |value: &f64| (0.0..=MAX_MEASURED).contains(value);
    let parts = result.parts.ok_or_else(|| missing("parts"))?;
    let parts = Parts {
        physics_secs: parts.physics_secs,
        drawing_secs: parts.drawing_secs,
        policy_secs: parts.policy_secs,
    };
    let secs = [result.wall_secs, parts.physics_secs, parts.drawing_secs, parts.policy_secs];
    if !residuals.iter().flatten().chain(&secs).all(fits) {
        return Err(invalid(format!(
            "`result` holds a number that is negative, not finite or above {MAX_MEASURED:e}"
        )));
    }
    let goal = result.goal.ok_or_else(|| missing("goal"))?;
    let goal =
        GoalProgress { predicates: goal.predicates, at_end: goal.at_end, at_most: goal.at_most };
    if !goal.agrees_with(result.success) {
        return Err(invalid(
            "`result` has goal progress that is inconsistent in itself or with `success`",
        ));
    }
    let ik = |residual_mm| IkResidual {
        residual_mm,
        residual_deg: result.ik_residual_deg.unwrap_or_default(),
        clamped_joints: result.ik_clamped_joints.unwrap_or_default(),
    };
    Ok(RolloutResult {
        success: result.success,
        steps: result.steps,
        wall_secs: result.wall_secs,
        ik: result.ik_residual_mm.map(ik),
        clipped_actions: result.clipped_actions,
        policy_queries: result.policy_queries,
        parts,
        goal,
        prompt: Some(shortened(&result.prompt, MAX_PROMPT_BYTES).to_owned())
            .filter(|prompt| !prompt.is_empty()),
    })
}

fn realised(axes: Vec<wire::RealisedAxis>) -> Result<Realised, Status> {
    let mut realised = Realised::default();
    for wire::RealisedAxis { axis: name, parameters, elements } in axes {
        let axis = name.parse().ok().filter(|axis: &Axis| !axis.def().parameters.is_empty());
        let values = parameters.iter().chain(&elements);
        let fits =
            values.clone().count() <= MAX_REALISED_VALUES && values.copied().all(f64::is_finite);
        match axis {
            Some(axis) if fits && realised.of(axis).is_none() => {
                realised.add(axis, parameters, elements);
            }
            _ => {
                return Err(invalid(format!(
                    "`realised` of axis `{}`: each axis must be metric, occur once \
                     and have at most {MAX_REALISED_VALUES} values, all finite",
                    shortened(&name, MAX_ROLLOUT_ID_BYTES)
                )));
            }
        }
    }
    Ok(realised)
}

fn realisation(name: &str) -> Result<String, Status> {
    name.parse::<libero_ctrl::Realisation>()
        .map(|realisation| realisation.to_string())
        .map_err(invalid)
}

fn look(name: &str) -> Result<Look, Status> {
    name.parse().map_err(invalid)
}

fn text(field: &str, value: String) -> Result<String, Status> {
    if value.len() > MAX_TEXT_BYTES {
        return Err(invalid(format!("`{field}` is longer than {MAX_TEXT_BYTES} bytes")));
    }
    Ok(printable(&value).into_owned())
}

fn settings(given: BTreeMap<String, String>) -> Result<BTreeMap<String, String>, Status> {
    // The worker adds up to four settings to those of the policy: `execute`, `horizon`, and two
    // about the execution model.
    if given.len() > proto::MAX_SETTINGS + 4 {
        let count = given.len();
        return Err(invalid(format!(
            "`policy_settings` has {count} entries; it may have at most {}",
            proto::MAX_SETTINGS + 4
        )));
    }
    let checked = given.into_iter().map(|(name, value)| {
        let name = text("policy_settings", name)?;
        Ok((name, text("policy_settings", value)?))
    });
    checked.collect()
}

fn required(field: &str, value: String) -> Result<String, Status> {
    if value.is_empty() {
        return Err(missing(field));
    }
    text(field, value)
}

fn digest(field: &str, value: &str) -> Result<String, Status> {
    let is_hex = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
    if value.len() == 64 && value.bytes().all(is_hex) {
        Ok(value.to_owned())
    } else {
        Err(invalid(format!("`{field}` is not a SHA-256 in lower-case hex")))
    }
}

fn digest_or_empty(field: &str, value: &str) -> Result<String, Status> {
    if value.is_empty() {
        return Ok(String::new());
    }
    digest(field, value)
}

fn missing(field: &str) -> Status {
    invalid(format!("`{field}` is missing"))
}
