//! Forecast of a campaign's duration for `coordinator campaign create --dry-run`, from the rollouts
//! that the workers of a running coordinator have finished.

use std::collections::BTreeMap;

use coordinator::client::{Client, Service};
use coordinator::words::duration_text;
use proto::coordinator::{ForecastRequest, SuiteRollouts};
use queue::expand::NewCampaign;
use queue::read::Forecast;
use serde::Serialize;
use terminal::{counted, wrapped};

use super::command::CommandError;
use super::json;
use super::planning::Planned;

/// Requests the forecast of a campaign. The error is a text that the dry run prints in place of the
/// forecast, since the other parts of a dry run need no coordinator.
pub(super) async fn request(client: &Client, campaign: &NewCampaign) -> Result<Forecast, String> {
    let mut rollouts: BTreeMap<&str, u64> = BTreeMap::new();
    for job in &campaign.jobs {
        let suite = job.task.split('/').next().unwrap_or_default();
        *rollouts.entry(suite).or_default() += 1;
    }
    request_for_suites(client, &campaign.policy, rollouts).await
}

pub(super) async fn request_for_suites(
    client: &Client,
    policy: &str,
    rollouts: impl IntoIterator<Item = (&str, u64)>,
) -> Result<Forecast, String> {
    let to_message =
        |(suite, rollouts): (&str, u64)| SuiteRollouts { suite: suite.to_owned(), rollouts };
    let request = ForecastRequest {
        policy: policy.to_owned(),
        rollouts: rollouts.into_iter().map(to_message).collect(),
    };
    let answer = client.ask(request, Service::forecast).await;
    answer.map_err(|error| format!("failed to {error}"))
}

pub(super) fn describe(answer: &Result<Forecast, String>, policy: &str) -> String {
    let forecast = match answer {
        Ok(forecast) => forecast,
        Err(problem) => return format!("no forecast of its duration: {problem}"),
    };
    let workers = counted(forecast.workers, "worker");
    let Some(secs) = forecast.secs else {
        let reason = match forecast.workers {
            0 => "no worker is connected".to_owned(),
            _ => format!(
                "on the {workers} connected now no rollout was finished in the last week. A \
                 campaign with `--configs 0` and one task of each suite measures them"
            ),
        };
        return wrapped("", 2, &format!("no forecast of its duration: {reason}"));
    };
    let duration = duration_text(secs);
    let slots = counted(forecast.slots, "slot");
    let measured_policies = match forecast.is_of_policy {
        true => format!("of {policy}"),
        false => format!("of other policies, since {policy} has none"),
    };
    let results = counted(forecast.results, "recent rollout");
    let mut words = format!(
        "about {duration} on the {workers} connected now ({slots}), if they run nothing else; \
         measured on {results} {measured_policies}"
    );
    if !forecast.unmeasured_suites.is_empty() {
        let suites = forecast.unmeasured_suites.join(", ");
        words += &format!("; {suites}: not measured, assumed to be as fast as the rest");
    }
    if let Some(useful) = forecast.useful_slots {
        words += &format!("; more slots on their cores help up to {useful}");
    }
    wrapped("", 2, &words)
}

pub(super) fn print(
    campaign: &NewCampaign,
    answer: Result<Forecast, String>,
    planning: &[Planned],
) -> Result<(), CommandError> {
    let (forecast, no_forecast) = match answer {
        Ok(forecast) => (Some(forecast), None),
        Err(problem) => (None, Some(problem)),
    };
    json::print(&DryRun {
        name: campaign.name.to_string(),
        policy: campaign.policy.clone(),
        rollouts: campaign.jobs.len(),
        placebo_rollouts: campaign.jobs.iter().filter(|job| job.is_placebo()).count(),
        execution: &campaign.execution,
        planning,
        forecast,
        no_forecast,
    })
}

/// Output of `campaign create --dry-run --json`; docs/JSON.md has the schema.
#[derive(Serialize)]
struct DryRun<'a> {
    name: String,
    policy: String,
    rollouts: usize,
    placebo_rollouts: usize,
    execution: &'a str,
    planning: &'a [Planned],
    forecast: Option<Forecast>,
    no_forecast: Option<String>,
}
