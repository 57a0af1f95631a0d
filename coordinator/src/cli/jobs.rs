//! `coordinator jobs list|show|retry|skip`.

use anyhow::anyhow;
use benchmark::RolloutId;
use clap::{Args, Subcommand};
use coordinator::client::Service;
use coordinator::words::duration_text;
use proto::coordinator::{
    GetJobRequest, JobName, ListJobsRequest, RetryJobsRequest, SkipJobsRequest,
};
use queue::clock::UnixMillis;
use queue::ids::shortened;
use queue::read::{JobDetails, JobLine};
use report::rollout_name;
use serde::Serialize;
use terminal::{counted, number_from};

use super::command::{CommandError, Connection, failure, print_line, usage};
use super::json;

/// Page size of `ListJobs` requests, jobs.
const PAGE_JOBS: u32 = 500;
/// Longest error in a line of the list, bytes.
const ERROR_BYTES: usize = 60;

#[derive(Debug, Subcommand)]
pub(super) enum JobsCommand {
    /// List the rollouts of a campaign and their states.
    List(ListArguments),
    /// Show one rollout with all its attempts.
    Show(ShowArguments),
    /// Requeue rollouts that are in quarantine.
    Retry(RetryArguments),
    /// Skip rollouts that are waiting or running: they are quarantined without a charge, and
    /// `jobs retry` requeues them.
    Skip(SkipArguments),
}

/// Printed below the long help.
const EXAMPLES: &str = "\
Examples:
  coordinator jobs list first --outcome failure --condition simultaneous
  coordinator jobs list first --state quarantined
  coordinator jobs list first --task libero_object/0 --level L2 --json";

#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct ListArguments {
    /// Name of the campaign.
    campaign: String,
    /// Only rollouts in this state.
    #[arg(long, value_parser = ["queued", "leased", "committed", "quarantined"])]
    state: Option<String>,
    /// Only rollouts with this outcome.
    #[arg(long, value_parser = ["success", "failure"])]
    outcome: Option<String>,
    /// Only rollouts of a task, such as `libero_object/0`, or of a suite.
    #[arg(long)]
    task: Option<String>,
    /// Only rollouts of a condition: `nominal`, `simultaneous`, an axis, or several axes
    /// such as `camera+robot`.
    #[arg(long, value_name = "CONDITION")]
    condition: Option<String>,
    /// Only rollouts of a level: `L2`, `r2.5`.
    #[arg(long)]
    level: Option<String>,
    /// Most rollouts to list.
    #[arg(long, default_value_t = 50, value_parser = number_from(1_u32, "rollouts"))]
    limit: u32,
    /// Print JSON, as docs/JSON.md describes it.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: Connection,
}

#[derive(Args, Debug)]
pub(super) struct ShowArguments {
    /// Name of the campaign.
    campaign: String,
    /// Rollout id; `ID#r1` is its second replicate.
    rollout: String,
    /// Print JSON, as docs/JSON.md describes it.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: Connection,
}

#[derive(Args, Debug)]
pub(super) struct RetryArguments {
    /// Name of the campaign.
    campaign: String,
    /// Rollout ids; `ID#r1` is a second replicate.
    #[arg(required_unless_present = "all")]
    rollouts: Vec<String>,
    /// Requeue all rollouts in quarantine.
    #[arg(long, conflicts_with = "rollouts")]
    all: bool,
    #[command(flatten)]
    connection: Connection,
}

#[derive(Args, Debug)]
pub(super) struct SkipArguments {
    /// Name of the campaign.
    campaign: String,
    /// Rollout ids; `ID#r1` is a second replicate.
    #[arg(required = true)]
    rollouts: Vec<String>,
    #[command(flatten)]
    connection: Connection,
}

/// Output of `jobs list --json`.
#[derive(Default, Serialize)]
struct Listed {
    jobs: Vec<JobLine>,
    /// True if `--limit` cut the list off.
    is_truncated: bool,
}

pub(super) async fn jobs(command: JobsCommand) -> Result<(), CommandError> {
    match command {
        JobsCommand::List(arguments) => list(arguments).await,
        JobsCommand::Show(arguments) => show(arguments).await,
        JobsCommand::Retry(arguments) => retry(arguments).await,
        JobsCommand::Skip(arguments) => skip(arguments).await,
    }
}

async fn list(arguments: ListArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let mut request = ListJobsRequest {
        campaign: arguments.campaign,
        state: arguments.state.unwrap_or_default(),
        outcome: arguments.outcome.unwrap_or_default(),
        task: arguments.task.unwrap_or_default(),
        condition: arguments.condition.unwrap_or_default(),
        level: arguments.level.unwrap_or_default(),
        ..ListJobsRequest::default()
    };
    let mut remaining = arguments.limit;
    let mut listed = Listed::default();
    loop {
        // The request asks for one job more than is shown, to detect whether further jobs exist.
        request.limit = remaining.min(PAGE_JOBS) + 1;
        let page: Vec<JobLine> = client.ask(request.clone(), Service::list_jobs).await?;
        let is_last = page.len() < request.limit as usize;
        for job in page.into_iter().take(request.limit as usize - 1) {
            request.after_job_id = job.job_id.0;
            remaining -= 1;
            match arguments.json {
                true => listed.jobs.push(job),
                false => print_line(&summary_line(&job))?,
            }
        }
        if !is_last && remaining > 0 {
            continue;
        }
        listed.is_truncated = !is_last;
        return match (arguments.json, is_last) {
            (true, _) => json::print(&listed),
            (false, true) => Ok(()),
            (false, false) => Ok(print_line("… and more: --limit shows them")?),
        };
    }
}

async fn show(arguments: ShowArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let request =
        GetJobRequest { job: Some(job_name(&arguments.rollout)?), campaign: arguments.campaign };
    let (now, details) = client.ask_at(request, Service::get_job).await?;
    match arguments.json {
        true => json::print(&details),
        false => Ok(print_line(&describe_job(&details, now)?)?),
    }
}

async fn retry(arguments: RetryArguments) -> Result<(), CommandError> {
    let names: Result<Vec<JobName>, CommandError> =
        arguments.rollouts.iter().map(|id| job_name(id)).collect();
    let request =
        RetryJobsRequest { campaign: arguments.campaign, jobs: names?, all: arguments.all };
    let client = arguments.connection.client()?;
    Ok(print_line(&match client.ask(request, Service::retry_jobs).await? {
        0 => "nothing is in quarantine".to_owned(),
        jobs => format!("{} requeued", counted(jobs, "rollout")),
    })?)
}

async fn skip(arguments: SkipArguments) -> Result<(), CommandError> {
    let names: Result<Vec<JobName>, CommandError> =
        arguments.rollouts.iter().map(|id| job_name(id)).collect();
    let request = SkipJobsRequest { campaign: arguments.campaign, jobs: names? };
    let client = arguments.connection.client()?;
    let skipped = counted(client.ask(request, Service::skip_jobs).await?, "rollout");
    Ok(print_line(&format!("{skipped} skipped"))?)
}

/// Parses `spatial/t0/camera/L2/c03`, or with a replicate `spatial/t0/camera/L2/c03#r1`.
fn job_name(text: &str) -> Result<JobName, CommandError> {
    let (rollout_id, replicate) = match text.split_once("#r") {
        None => (text, Some(0)),
        Some((id, replicate)) => (id, replicate.parse().ok()),
    };
    // Parsing maps the paper's spellings of an id to the released ones.
    let parsed: Result<RolloutId, _> = rollout_id.parse();
    let rollout_id = parsed.map_or_else(|_| rollout_id.to_owned(), |id| id.to_string());
    let replicate = replicate.ok_or_else(|| {
        let error = anyhow!("write a rollout id, and #r1 after it for its second replicate");
        usage(error.context(format!("read rollout `{text}`")))
    })?;
    Ok(JobName { rollout_id, replicate })
}

fn replicate_name(job: &JobLine) -> String {
    rollout_name(&job.rollout_id, job.replicate)
}

/// Describes the state of a job, such as its lease, backoff or outcome.
fn describe_state(job: &JobLine) -> String {
    match (job.state.as_str(), &job.worker_id, job.backoff_left_secs, &job.outcome) {
        (_, Some(worker), ..) => format!(
            "running on {worker}, control step {}, lease ends in {}",
            job.control_steps.unwrap_or_default(),
            duration_text(job.lease_left_secs.unwrap_or_default())
        ),
        (_, _, Some(secs), _) if secs > 0.0 => format!("waits {}", duration_text(secs)),
        ("queued", ..) => "waits".to_owned(),
        (.., Some(outcome)) => {
            format!("{outcome} after {} steps", job.steps.unwrap_or_default())
        }
        (state, ..) => state.to_owned(),
    }
}

fn summary_line(job: &JobLine) -> String {
    let mut line = format!("{:<36} {}", replicate_name(job), describe_state(job));
    if job.charged_attempts > 0 {
        line.push_str(&format!(", {} charged", job.charged_attempts));
    }
    if let Some(error) = job.last_error.as_ref().filter(|_| job.outcome.is_none()) {
        line.push_str(&format!(": {}", shortened(error, ERROR_BYTES)));
    }
    line
}

/// Describes a job at the instant `now` of the coordinator.
fn describe_job(details: &JobDetails, now: UnixMillis) -> Result<String, CommandError> {
    let job = &details.job;
    let ago = |at| duration_text(now.since(at).as_secs_f64());
    let mut lines = vec![
        format!("{}  (job {})", replicate_name(job), job.job_id),
        format!("  now            {}", describe_state(job)),
        format!("  attempts       {}, of which {} are charged", job.attempts, job.charged_attempts),
    ];
    if details.late_reports > 0 {
        lines.push(format!("  late reports   {} refused", details.late_reports));
    }
    if let Some(result) = &details.result {
        lines.push(format!(
            "  result         attempt {} by {} on {} ({}, look {}), {:.1} s, {} ago",
            result.attempt,
            result.worker_id,
            result.host,
            result.renderer,
            result.look,
            result.wall_secs,
            ago(result.committed_at)
        ));
        lines.extend(result.prompt.iter().map(|prompt| format!("  prompt         {prompt}")));
        if result.divergences > 0 {
            lines.push(format!(
                "  divergent      reported {} times with another outcome",
                result.divergences
            ));
        }
        lines.extend(result.video.iter().map(|video| format!("  video          {video}")));
    }
    for failure in &details.failures {
        lines.push(format!(
            "  attempt {:<6} {} on {}, {} ago{}: {}",
            failure.attempt,
            failure.reason.replace('_', " "),
            failure.worker_id,
            ago(failure.failed_at),
            if failure.is_charged { "" } else { ", not charged" },
            failure.error
        ));
    }
    let manifest_row = serde_json::to_string(&details.manifest_row).map_err(failure)?;
    lines.push(format!("  manifest row   {manifest_row}"));
    Ok(lines.join("\n"))
}
