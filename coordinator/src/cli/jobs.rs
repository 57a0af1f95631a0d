//! `coordinator jobs`.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::anyhow;
use benchmark::{AxisSet, RolloutId};
use clap::{ArgGroup, Args};
use coordinator::client::{Client, Service};
use coordinator::words::duration_text;
use proto::coordinator::{
    GetJobRequest, JobName, ListJobsRequest, RetryJobsRequest, SkipJobsRequest,
};
use queue::clock::UnixMillis;
use queue::ids::shortened;
use queue::read::{JobDetails, JobLine};
use report::{Findings, rollout_name};
use serde::Serialize;
use terminal::{counted, number_from};

use super::command::{CommandError, Connection, failure, print_line, usage};
use super::files::AtomicFile;
use super::json;

/// Page size of `ListJobs` requests, jobs.
const PAGE_JOBS: u32 = 500;
/// Longest error in a line of the list, bytes.
const ERROR_BYTES: usize = 60;

/// Printed below the long help.
const EXAMPLES: &str = "\
Examples:
  coordinator jobs first --outcome failure --condition simultaneous
  coordinator jobs first --task libero_object/0 --level L2 --json
  coordinator jobs first object/t0/camera/L2/c03      # one with all its attempts
  coordinator jobs first object/t0/camera/L2/c03 --capsule f.capsule
  coordinator jobs first --retry                      # requeues all in quarantine";

#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES)]
#[command(group = ArgGroup::new("filters").multiple(true)
    .conflicts_with_all(["rollouts", "retry", "skip"]))]
pub(super) struct JobsArguments {
    /// Name of the campaign.
    campaign: String,
    /// Id of a rollout to be shown with all its attempts, or ids to requeue or to skip; `ID#r1` is
    /// a second replicate. If omitted, the rollouts and their states are listed.
    #[arg(value_name = "ROLLOUT")]
    rollouts: Vec<String>,
    /// Requeue the rollouts, or all that are in quarantine if none is named.
    #[arg(long)]
    retry: bool,
    /// Skip the rollouts, which wait or run: they are quarantined without a charge, and --retry
    /// requeues them.
    #[arg(long, requires = "rollouts", conflicts_with = "retry")]
    skip: bool,
    /// List only rollouts in this state.
    #[arg(long, group = "filters", value_parser = ["queued", "leased", "committed", "quarantined"])]
    state: Option<String>,
    /// List only rollouts with this outcome.
    #[arg(long, group = "filters", value_parser = ["success", "failure"])]
    outcome: Option<String>,
    /// List only rollouts of a task, such as `libero_object/0`, or of a suite.
    #[arg(long, group = "filters")]
    task: Option<String>,
    /// List only rollouts of a condition: `nominal`, `simultaneous`, an axis, or several axes such
    /// as `camera+robot`.
    #[arg(long, group = "filters", value_name = "CONDITION")]
    condition: Option<String>,
    /// List only rollouts of a level: `L2`, `r2.5`.
    #[arg(long, group = "filters")]
    level: Option<String>,
    /// Most rollouts to list.
    #[arg(long, group = "filters", default_value_t = 50,
        value_parser = number_from(1_u32, "rollouts"))]
    limit: u32,
    /// Write finished rollouts to a file, one per line. `worker rollout --capsule` repeats the
    /// first, without its policy and the coordinator; training starts from all. The campaign must
    /// store actions (`--record transitions`).
    #[arg(long, value_name = "FILE", requires = "rollouts",
        conflicts_with_all = ["retry", "skip", "json", "filters"])]
    capsule: Option<PathBuf>,
    /// Print JSON, as docs/JSON.md describes it.
    #[arg(long, conflicts_with_all = ["retry", "skip"])]
    json: bool,
    #[command(flatten)]
    connection: Connection,
}

/// Output of `jobs CAMPAIGN --json`.
#[derive(Default, Serialize)]
struct Listed {
    jobs: Vec<JobLine>,
    /// True if `--limit` cut the list off.
    is_truncated: bool,
}

pub(super) async fn jobs(arguments: JobsArguments) -> Result<(), CommandError> {
    let names = arguments.rollouts.iter().map(|id| job_name(id));
    let jobs: Vec<JobName> = names.collect::<Result<_, _>>()?;
    let client = arguments.connection.client()?;
    let campaign = arguments.campaign.clone();
    if arguments.skip {
        let request = SkipJobsRequest { campaign, jobs };
        let skipped = counted(client.ask(request, Service::skip_jobs).await?, "rollout");
        return Ok(print_line(&format!("{skipped} skipped"))?);
    }
    if arguments.retry {
        let request = RetryJobsRequest { campaign, all: jobs.is_empty(), jobs };
        return Ok(print_line(&match client.ask(request, Service::retry_jobs).await? {
            0 => "nothing is in quarantine".to_owned(),
            jobs => format!("{} requeued", counted(jobs, "rollout")),
        })?);
    }
    if let Some(file) = &arguments.capsule {
        return write_capsules(&client, &campaign, jobs, file).await;
    }
    match <[JobName; 1]>::try_from(jobs) {
        Ok([job]) => {
            let request = GetJobRequest { campaign, job: Some(job) };
            show(&client, request, arguments.json).await
        }
        Err(none) if none.is_empty() => list(&client, arguments).await,
        Err(_) => Err(usage(anyhow!(
            "show rollouts of campaign `{campaign}`: one at a time; name one, or pass --retry or \
             --skip"
        ))),
    }
}

async fn list(client: &Client, arguments: JobsArguments) -> Result<(), CommandError> {
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
            if arguments.json { listed.jobs.push(job) } else { print_line(&summary_line(&job))? }
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

async fn show(client: &Client, request: GetJobRequest, json: bool) -> Result<(), CommandError> {
    let (now, mut details): (_, JobDetails) = client.ask_at(request, Service::get_job).await?;
    details.capsule = None;
    if json { json::print(&details) } else { Ok(print_line(&describe_job(&details, now)?)?) }
}

async fn write_capsules(
    client: &Client,
    campaign: &str,
    jobs: Vec<JobName>,
    file: &Path,
) -> Result<(), CommandError> {
    let explained = minimal_axes(client, campaign).await?;
    let count = jobs.len();
    let mut written = AtomicFile::create(file)?;
    for job in jobs {
        let request = GetJobRequest { campaign: campaign.to_owned(), job: Some(job) };
        let details: JobDetails = client.ask(request, Service::get_job).await?;
        let capsule = details.capsule.filter(|capsule| !capsule.actions.is_empty());
        let mut capsule = capsule.ok_or_else(|| {
            failure(anyhow!(
                "make a capsule of {}: it has no stored actions; campaigns with `--record \
                 transitions` store those of finished rollouts",
                replicate_name(&details.job)
            ))
        })?;
        let found = explained.get(&capsule.manifest_row.id);
        capsule.minimal_axes = found.cloned().unwrap_or_default();
        serde_json::to_writer(written.writer(), &capsule).map_err(failure)?;
        writeln!(written.writer()).map_err(failure)?;
    }
    written.finish()?;
    let counted = counted(count as u64, "rollout");
    Ok(print_line(&format!("wrote {counted} to {}", file.display()))?)
}

/// Returns the minimal subsets of the simultaneous rollouts that `explain` explained.
async fn minimal_axes(
    client: &Client,
    campaign: &str,
) -> Result<BTreeMap<RolloutId, Vec<AxisSet>>, CommandError> {
    let explaining = format!("{campaign}-explained");
    let campaigns = client.list_campaigns().await?;
    if !campaigns.iter().any(|status| status.name == explaining) {
        return Ok(BTreeMap::new());
    }
    let findings = Findings::of(&client.report(&explaining).await?).map_err(failure)?;
    let findings = findings.filter(|findings| findings.campaign == campaign);
    let explained = findings.into_iter().flat_map(|findings| findings.configurations);
    Ok(explained
        .map(|explained| {
            let answers = explained.explanation.answers.iter();
            let minimal = answers.flat_map(|answer| &answer.minimal).map(|minimal| minimal.set);
            (explained.configuration, minimal.collect())
        })
        .collect())
}

/// Parses `spatial/t0/camera/L2/c03`, or with a replicate `spatial/t0/camera/L2/c03#r1`.
fn job_name(text: &str) -> Result<JobName, CommandError> {
    let (rollout_id, replicate) = match text.split_once("#r") {
        None => (text, Some(0)),
        Some((id, replicate)) => (id, replicate.parse().ok()),
    };
    // Parsing maps every accepted spelling of an id to the stored one.
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
