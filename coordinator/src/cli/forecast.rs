//! How long a campaign would take, from what a running coordinator's workers have
//! measured: part of `coordinator campaign create --dry-run`.

use std::collections::BTreeMap;

use coordinator::client::{Client, Service};
use coordinator::words::duration_text;
use proto::coordinator::{ForecastRequest, ForecastResponse, SuiteRollouts};
use queue::expand::NewCampaign;
use terminal::counted;

/// How long the campaign would take, in words. Without a coordinator, or without
/// access to it, they say so: what else a dry run says needs none.
pub(super) async fn in_words(client: &Client, campaign: &NewCampaign) -> String {
    let mut rollouts: BTreeMap<&str, u64> = BTreeMap::new();
    for job in &campaign.jobs {
        let suite = job.task.split('/').next().unwrap_or_default();
        *rollouts.entry(suite).or_default() += 1;
    }
    let of_suite = |(suite, rollouts): (&str, u64)| SuiteRollouts {
        suite: suite.to_owned(),
        rollouts,
    };
    let request = ForecastRequest {
        policy: campaign.policy.clone(),
        rollouts: rollouts.into_iter().map(of_suite).collect(),
    };
    match client.call(request, Service::forecast).await {
        Ok(forecast) => words(&forecast, &campaign.policy),
        Err(error) => format!("no forecast of its duration: failed to {error}"),
    }
}

fn words(forecast: &ForecastResponse, policy: &str) -> String {
    let workers = counted(forecast.workers.into(), "worker");
    let slots = counted(forecast.slots.into(), "slot");
    let Some(secs) = forecast.secs else {
        return match forecast.workers {
            0 => "no forecast of its duration: no worker is connected".to_owned(),
            _ => format!(
                "no forecast of its duration: no worker has been measured: on the {workers}\n\
                 connected now no rollout was finished in the last week"
            ),
        };
    };
    let mut lines = vec![format!(
        "about {} on the {workers} connected now ({slots}), if they run nothing else",
        duration_text(secs)
    )];
    let whose = match forecast.is_of_policy {
        true => format!("of {policy}"),
        false => format!("of other policies; none of {policy} was"),
    };
    lines.push(format!(
        "  measured on {} {whose}",
        counted(forecast.results, "recent rollout")
    ));
    if !forecast.unmeasured_suites.is_empty() {
        lines.push(format!(
            "  {}: not measured, taken to be as fast",
            forecast.unmeasured_suites.join(", ")
        ));
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_forecast_says_what_it_rests_on_and_fits_the_terminal() {
        let forecast = ForecastResponse {
            workers: 2,
            slots: 16,
            secs: Some(12_000.0),
            results: 200,
            is_of_policy: true,
            unmeasured_suites: vec!["libero_10".to_owned(), "libero_goal".to_owned()],
        };
        let text = words(&forecast, "pi05");
        assert_eq!(
            text,
            "about 3h20m on the 2 workers connected now (16 slots), if they run nothing else\n  \
             measured on 200 recent rollouts of pi05\n  \
             libero_10, libero_goal: not measured, taken to be as fast"
        );
        assert!(text.lines().all(|line| line.chars().count() <= 80));
    }

    #[test]
    fn without_a_measurement_there_is_no_forecast() {
        let unmeasured = ForecastResponse {
            workers: 1,
            slots: 2,
            ..ForecastResponse::default()
        };
        let text = words(&unmeasured, "pi05");
        assert!(text.contains("no worker has been measured"), "{text}");
        let text = words(&ForecastResponse::default(), "pi05");
        assert!(text.ends_with("no worker is connected"), "{text}");
    }
}
