//! `coordinator explain`: which axes it takes to change an outcome.

use std::time::Duration;

use anyhow::anyhow;
use clap::Args;
use coordinator::client::{Client, Service};
use proto::coordinator::{CreateCampaignRequest, GetCampaignRequest};
use protocol::{CampaignSpec, Explanation, PolicyRoute, Realisation, Record, Rollouts, Wanted};
use report::Findings;
use terminal::{number, number_from};

use super::command::{CommandError, Connection, print_line, usage};
use super::create::{RECORDS, one_of};

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
    /// Subsets that are filmed: `none`; `transitions`, those that show the explanation,
    /// afterwards, by `worker film`; `failures`; or `all`. [default: as CAMPAIGN]
    #[arg(long, value_parser = one_of::<Record>(RECORDS))]
    record: Option<Record>,
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
    let is_there = match arguments.asks_for_something() {
        true => false,
        false => is_there(&client, &arguments.campaign, &name).await?,
    };
    if !is_there {
        begin(&client, &arguments, &name).await?;
    }
    let mut told = String::new();
    loop {
        let by = client.report(&name).await?;
        let findings = Findings::of(&by).map_err(usage)?;
        let findings = findings
            .ok_or_else(|| anyhow!("show what `{name}` explains: it explains no campaign"))?;
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
        self.budget.is_some()
            || self.seed.is_some()
            || self.exhaustive
            || self.repeats.is_some()
            || self.record.is_some()
    }
}

/// Whether there is a campaign of this name, and it explains the other.
async fn is_there(client: &Client, campaign: &str, name: &str) -> Result<bool, CommandError> {
    let all = client.list_campaigns().await?;
    if !all.iter().any(|status| status.campaign == name) {
        return Ok(false);
    }
    Ok(match spec(client, name).await?.rollouts {
        Rollouts::Explanation(explanation) => explanation.campaign == campaign,
        Rollouts::Design(_) | Rollouts::Manifest(_) => false,
    })
}

async fn spec(client: &Client, name: &str) -> Result<CampaignSpec, CommandError> {
    let request = GetCampaignRequest {
        campaign: name.to_owned(),
    };
    let answer = client.call(request, Service::get_campaign).await?;
    CampaignSpec::from_json(&answer.spec).map_err(usage)
}

/// Creates the campaign, unless it is there as it would be created.
async fn begin(
    client: &Client,
    arguments: &ExplainArguments,
    name: &str,
) -> Result<(), CommandError> {
    let explained = client.campaign_status(&arguments.campaign).await?;
    let explanation = Explanation {
        campaign: arguments.campaign.clone(),
        budget: arguments.budget,
        seed: arguments.seed.unwrap_or_default(),
        exhaustive: arguments.exhaustive,
        repeats: arguments.repeats,
    };
    let record = match arguments.record {
        Some(record) => record,
        None => spec(client, &arguments.campaign).await?.record,
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
        record,
        wanted: Wanted::default(),
    };
    spec.check().map_err(usage)?;
    let campaign = client.report(&arguments.campaign).await?;
    Findings::can_be_of(&campaign, &explanation).map_err(usage)?;
    let request = CreateCampaignRequest {
        spec: serde_json::to_string(&spec).map_err(anyhow::Error::from)?,
        priority: explained.priority,
    };
    client.call(request, Service::create_campaign).await?;
    if explained.queued + explained.leased > 0 {
        eprintln!(
            "campaign {} has {} rollouts without an outcome; its transitions are explained once \
             it is through",
            arguments.campaign,
            explained.queued + explained.leased
        );
    }
    Ok(())
}
