//! Validation of request messages: strings are bounded and free of terminal control sequences,
//! numbers are within range, and digests are well-formed.

use std::borrow::Cow;
use std::collections::BTreeMap;

use benchmark::attempt::{AttemptId, MAX_TEXT_BYTES, Measurement, Motion, Pin, Provenance};
use benchmark::{Look, Suite, select_tasks};
use proto::{MAX_MOTION_STEPS, coordinator as wire};
use queue::ids::{CampaignName, JobId, JobName, WorkerId, json_problem, shortened};
use queue::read::JobFilter;
use queue::rules::campaign::{Change, PRIORITIES};
use queue::rules::lease::FailureReason;
use queue::{
    Alteration, AppendedRow, CommitReport, MAX_JOBS_RETRIED, MAX_SLOTS, Retry, WorkerInfo,
};
use serde_json::Value;
use terminal::printable;
use tonic::Status;

use super::failure::invalid;

/// Longest accepted rollout id, bytes.
const MAX_ROLLOUT_ID_BYTES: usize = 128;
/// Longest quotation of a request's text in an error, bytes.
const MAX_QUOTED_BYTES: usize = 128;
/// Longest stored error message, bytes; longer ones are truncated.
const MAX_ERROR_BYTES: usize = 4_096;
/// Longest path and actions of a motion, bytes: 6 per position and 28 per action.
const MAX_PATH_BYTES: usize = (MAX_MOTION_STEPS + 1) * 6;
const MAX_ACTIONS_BYTES: usize = MAX_MOTION_STEPS * 28;

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
pub(super) fn film_pin(request: wire::NextFilmRequest) -> Result<Pin, Status> {
    Ok(Pin {
        asset_pack_digest: required("asset_pack_digest", request.asset_pack_digest)?,
        mujoco_version: required("mujoco_version", request.mujoco_version)?,
        look: look(&request.look)?,
        ..Pin::default()
    })
}

/// Reads a reported result. The texts of its provenance become printable. The prompt is stored as the
/// policy got it; programs make it printable when they show it.
pub(super) fn commit(request: wire::CommitRequest) -> Result<CommitReport, Status> {
    let text = &request.measurement;
    let unreadable = |error: serde_json::Error| {
        // An error of a value's type names no field, only the column after the value: the field is
        // the last name before that column.
        let before = text.get(..error.column()).unwrap_or(text).rsplit_once("\":");
        let field = before.and_then(|(before, _)| before.rsplit('"').next()).unwrap_or_default();
        let field = shortened(field, MAX_QUOTED_BYTES).to_owned();
        invalid(format!("read `measurement` after `{field}`: {}", json_problem(error)))
    };
    let Measurement { result, provenance } = Measurement::from_json(text).map_err(unreadable)?;
    let provenance = serde_json::to_value(provenance).map(printable_texts);
    let provenance: Provenance = provenance.and_then(serde_json::from_value).map_err(unreadable)?;
    if let Some(problem) = result.problem().or_else(|| provenance.problem()) {
        return Err(invalid(problem));
    }
    Ok(CommitReport {
        attempt: attempt(&request.attempt_id)?,
        measurement: Measurement { result, provenance },
        motion: motion(request.motion.unwrap_or_default())?,
    })
}

fn printable_texts(value: Value) -> Value {
    match value {
        Value::String(text) => Value::String(printable(&text).into_owned()),
        Value::Object(fields) => {
            let printed = |(name, value): (String, _)| {
                (printable(&name).into_owned(), printable_texts(value))
            };
            Value::Object(fields.into_iter().map(printed).collect())
        }
        // A provenance has no arrays of texts.
        value => value,
    }
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

pub(super) fn rollouts_by_suite(
    requests: Vec<wire::SuiteRollouts>,
) -> Result<BTreeMap<String, u64>, Status> {
    let mut rollouts = BTreeMap::new();
    for requested in requests {
        // The parser knows only LIBERO's suites; `own` stands for the tasks of suite files, and
        // `simulated` for those of other simulators.
        if ![Suite::Own, Suite::Simulated].map(Suite::name).contains(&&*requested.suite) {
            let _: Suite = requested.suite.parse().map_err(invalid)?;
        }
        let total: &mut u64 = rollouts.entry(requested.suite).or_default();
        *total = total.saturating_add(requested.rollouts);
    }
    Ok(rollouts)
}

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
                    shortened(other, MAX_QUOTED_BYTES)
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
            shortened(other, MAX_QUOTED_BYTES)
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

pub(super) fn rows(rows: Vec<wire::AppendedRow>) -> Result<Vec<AppendedRow>, Status> {
    let read = |(index, row): (usize, wire::AppendedRow)| {
        let unreadable = |error| {
            invalid(format!("read row {} of the added rows: {}", index + 1, json_problem(error)))
        };
        let replicates = row.replicates;
        let row = serde_json::from_str(&row.manifest_row).map_err(unreadable)?;
        Ok(AppendedRow { row, replicates })
    };
    rows.into_iter().enumerate().map(read).collect()
}

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

fn look(name: &str) -> Result<Look, Status> {
    name.parse().map_err(invalid)
}

fn text(field: &str, value: String) -> Result<String, Status> {
    if value.len() > MAX_TEXT_BYTES {
        return Err(invalid(format!("`{field}` is longer than {MAX_TEXT_BYTES} bytes")));
    }
    Ok(printable(&value).into_owned())
}

fn required(field: &str, value: String) -> Result<String, Status> {
    if value.is_empty() {
        return Err(missing(field));
    }
    text(field, value)
}

fn missing(field: &str) -> Status {
    invalid(format!("`{field}` is missing"))
}
