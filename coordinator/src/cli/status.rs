//! `coordinator campaign status`: all campaigns, in one line of at most 79 columns each, or the
//! details of one. `--watch` is implemented in `watch`.

use std::collections::BTreeMap;

use clap::Args;
use coordinator::client::{Client, Service};
use coordinator::words::duration_text;
use proto::coordinator::ListJobsRequest;
use queue::read::{CampaignStatus, JobLine};
use terminal::{counted, wrapped};

use super::command::{CommandError, Connection, print_line};
use super::json;
use super::line::{line, operator_notes};
use super::watch::watch;
use super::workers::{describe_filming, filming};

/// Line that is printed if there are no campaigns.
const NO_CAMPAIGNS: &str = "no campaigns yet; `coordinator campaign create` makes one";

#[derive(Args, Debug)]
pub(super) struct StatusArguments {
    /// Name of the campaign; all campaigns, in a line each, if omitted.
    campaign: Option<String>,
    /// Follow the progress until the campaign is finished, or all campaigns if none is named.
    #[arg(long)]
    watch: bool,
    /// Print JSON, as docs/JSON.md describes it.
    #[arg(long, conflicts_with = "watch")]
    json: bool,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn status(arguments: StatusArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let name = arguments.campaign.as_deref();
    let campaigns = match (arguments.watch, name) {
        (true, name) => watch(&client, name).await?,
        (false, Some(name)) => vec![client.campaign_status(name).await?],
        (false, None) => client.list_campaigns().await?,
    };
    if arguments.json {
        return print_json(campaigns);
    }
    if campaigns.is_empty() {
        return Ok(print_line(NO_CAMPAIGNS)?);
    }
    let mut text: Vec<String> = match name {
        Some(_) => campaigns.iter().map(details).collect(),
        None => campaigns.iter().map(brief).collect(),
    };
    if let Some(name) = name {
        text.extend(failing(&client, name).await?);
    }
    text.extend(describe_filming(filming(&client).await?));
    Ok(print_line(&text.join("\n"))?)
}

fn print_json(mut campaigns: Vec<CampaignStatus>) -> Result<(), CommandError> {
    campaigns.iter_mut().for_each(|status| status.policy_retry_secs = None);
    json::print(&BTreeMap::from([("campaigns", campaigns)]))
}

/// Describes the failed attempts that are charged to rollouts which are not yet in quarantine;
/// `None` without any. Looks at as many rollouts of each state as one call returns.
async fn failing(client: &Client, campaign: &str) -> Result<Option<String>, CommandError> {
    let mut failing = Vec::new();
    for state in ["queued", "leased"] {
        let request = ListJobsRequest {
            campaign: campaign.to_owned(),
            state: state.to_owned(),
            limit: u32::MAX,
            ..ListJobsRequest::default()
        };
        let jobs: Vec<JobLine> = client.ask(request, Service::list_jobs).await?;
        failing.extend(jobs.into_iter().filter(|job| job.charged_attempts > 0));
    }
    let Some(worst) = failing.iter().max_by_key(|job| job.charged_attempts) else {
        return Ok(None);
    };
    let rollouts = counted(failing.len() as u64, "rollout");
    let attempts = counted(worst.charged_attempts.into(), "attempt");
    Ok(Some(wrapped(
        "  failing      ",
        15,
        &format!(
            "{rollouts} not in quarantine yet; `{}` failed in {attempts}: {}",
            worst.rollout_id,
            worst.last_error.as_deref().unwrap_or_default()
        ),
    )))
}

fn brief(status: &CampaignStatus) -> String {
    let notes = operator_notes(status).map(|notes| format!("\n  {notes}"));
    line(status) + &notes.unwrap_or_default()
}

fn details(status: &CampaignStatus) -> String {
    let rollouts = &status.rollouts;
    let mut lines = vec![
        line(status),
        format!("  policy       {} at {}", status.policy, status.endpoint),
        format!("  priority     {:>7}", status.priority),
        format!("  committed    {:>7}", rollouts.committed),
        format!("  succeeded    {:>7}", rollouts.succeeded),
        format!("  running      {:>7}", rollouts.leased),
        format!("  waiting      {:>7}", rollouts.queued),
        format!("  quarantined  {:>7}", rollouts.quarantined),
        format!("  live workers {:>7}", status.live_workers),
    ];
    if let Some(early) = &status.early_stop {
        lines.push(format!(
            "  ends early   once {}; random order of seed {}, in rounds of {}",
            early.stop.rule,
            early.stop.seed,
            early.stop.strata.name()
        ));
    }
    lines.extend(status.follows_from.iter().map(|source| format!("  follows from {source}")));
    if let Some(secs) = status.policy_retry_secs {
        let when = match secs >= 1.0 {
            true => format!("in {}", duration_text(secs)),
            false => "by the next rollout that a worker claims".to_owned(),
        };
        lines.push(format!(
            "  policy retry {when}; `coordinator campaign resume {}` retries at once",
            status.name
        ));
    }
    lines.extend(operator_notes(status).map(|notes| format!("  note         {notes}")));
    lines.join("\n")
}
