//! `coordinator explain`: which axes it takes to change an outcome.

use std::time::Duration;

use clap::Args;
use coordinator::client::{Client, Service};
use proto::coordinator::campaign_status::State;
use proto::coordinator::{CreateCampaignRequest, GetCampaignRequest};
use protocol::{CampaignSpec, Explanation, PolicyRoute, Realisation, Record, Rollouts, Wanted};
use report::Findings;
use terminal::{number, number_from};

use super::command::{CommandError, Connection, print_line, usage};

/// Between two looks at what was found.
const LOOK_AGAIN: Duration = Duration::from_secs(2);
/// Most replicates of one subset.
const MAX_REPEATS: u32 = 1_000;

#[derive(Args, Debug)]
pub(super) struct ExplainArguments {
    /// Campaign whose emergent failures and compensated successes are explained,
    /// once it is through.
    campaign: String,
    /// Name of the campaign that runs the subsets. [default: CAMPAIGN-explained]
    #[arg(long)]
    name: Option<String>,
    /// Most rollouts, spent on transitions in random order; without it, every
    /// transition is explained.
    #[arg(long, value_name = "N", value_parser = number(1..=u32::MAX, "rollouts"))]
    budget: Option<u32>,
    /// What that order is drawn from.
    #[arg(long, value_parser = number_from(0_u64, ""))]
    seed: Option<u64>,
    /// Run every subset, and not only those that decide which of them are minimal.
    #[arg(long)]
    exhaustive: bool,
    /// For a policy that samples: most replicates by which it is decided whether a
    /// subset succeeds. Without it, one rollout decides.
    #[arg(long, value_name = "N", value_parser = number(2..=MAX_REPEATS, "replicates"))]
    repeats: Option<u32>,
    /// Follow until everything is explained.
    #[arg(long)]
    watch: bool,
    /// Print JSON, as docs/JSON.md describes it.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn explain(arguments: ExplainArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let usual = || format!("{}-explained", arguments.campaign);
    let name = arguments.name.clone().unwrap_or_else(usual);
    let found = match arguments.asks_for_something() {
        true => None,
        false => there(&client, &arguments.campaign, &name).await?,
    };
    let explanation = match found {
        Some(explanation) => explanation,
        None => begin(&client, &arguments, &name).await?,
    };
    let mut told = String::new();
    loop {
        let campaign = client.report(&arguments.campaign).await?;
        let by = client.report(&name).await?;
        let findings = Findings::of(&campaign, &by, &explanation).map_err(usage)?;
        if !arguments.watch || findings.complete {
            let text = match arguments.json {
                true => findings.json().map_err(anyhow::Error::from)?,
                false => findings.text(),
            };
            return Ok(print_line(text.trim_end())?);
        }
        let text = findings.text();
        let standing = text.lines().next().unwrap_or_default();
        if standing != told {
            eprintln!("{standing}");
            standing.clone_into(&mut told);
        }
        tokio::time::sleep(LOOK_AGAIN).await;
    }
}

impl ExplainArguments {
    /// Whether it says how to explain, and not only what.
    fn asks_for_something(&self) -> bool {
        self.budget.is_some() || self.seed.is_some() || self.exhaustive || self.repeats.is_some()
    }
}

/// What a campaign of this name that explains the other is to find out, if there is one.
async fn there(
    client: &Client,
    campaign: &str,
    name: &str,
) -> Result<Option<Explanation>, CommandError> {
    let all = client.list_campaigns().await?;
    if !all.iter().any(|status| status.campaign == name) {
        return Ok(None);
    }
    let request = GetCampaignRequest {
        campaign: name.to_owned(),
    };
    let answer = client.call(request, Service::get_campaign).await?;
    let spec = CampaignSpec::from_json(&answer.spec).map_err(usage)?;
    Ok(match spec.rollouts {
        Rollouts::Explanation(explanation) if explanation.campaign == campaign => Some(explanation),
        _ => None,
    })
}

/// Creates the campaign, unless it is there as it would be created.
async fn begin(
    client: &Client,
    arguments: &ExplainArguments,
    name: &str,
) -> Result<Explanation, CommandError> {
    let explained = client.campaign_status(&arguments.campaign).await?;
    let explanation = Explanation {
        campaign: arguments.campaign.clone(),
        budget: arguments.budget,
        seed: arguments.seed.unwrap_or_default(),
        exhaustive: arguments.exhaustive,
        repeats: arguments.repeats,
    };
    let spec = CampaignSpec {
        name: name.to_owned(),
        policy: PolicyRoute {
            name: explained.policy,
            endpoint: explained.policy_endpoint,
        },
        rollouts: Rollouts::Explanation(explanation.clone()),
        realisation: Realisation::Matched,
        replicates: 1,
        record: Record::None,
        wanted: Wanted::default(),
        stop: None,
    };
    spec.check().map_err(usage)?;
    let campaign = client.report(&arguments.campaign).await?;
    Findings::can_be_of(&campaign, &explanation).map_err(usage)?;
    let request = CreateCampaignRequest {
        spec: serde_json::to_string(&spec).map_err(anyhow::Error::from)?,
        priority: explained.priority,
    };
    client.call(request, Service::create_campaign).await?;
    if explained.state() != State::Stopped && explained.queued + explained.leased > 0 {
        eprintln!(
            "campaign {} has {} rollouts without an outcome; its transitions are explained once \
             it is through",
            arguments.campaign,
            explained.queued + explained.leased
        );
    }
    Ok(explanation)
}
