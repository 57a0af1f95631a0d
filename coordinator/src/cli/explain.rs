//! `coordinator explain`: which axes it takes to change an outcome.

use clap::Args;
use coordinator::client::Client;
use protocol::{Explanation, Rollouts};
use report::Findings;
use terminal::{number, number_from};

use super::command::{CommandError, Connection, print_line, usage};
use super::derived;

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
    let there = match arguments.asks_for_something() {
        true => None,
        false => there(&client, &arguments.campaign, &name).await?,
    };
    let explanation = match there {
        Some(explanation) => explanation,
        None => begin(&client, &arguments, &name).await?,
    };
    let found = async || {
        let campaign = client.report(&arguments.campaign).await?;
        let by = client.report(&name).await?;
        Findings::of(&campaign, &by, &explanation).map_err(usage)
    };
    let is_complete = |found: &Findings| found.complete;
    let found = derived::look(arguments.watch, found, is_complete, Findings::text).await?;
    let text = match arguments.json {
        true => found.json().map_err(anyhow::Error::from)?,
        false => found.text(),
    };
    Ok(print_line(text.trim_end())?)
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
    Ok(match derived::rollouts(client, name).await? {
        Some(Rollouts::Explanation(there)) if there.campaign == campaign => Some(there),
        _ => None,
    })
}

/// Creates the campaign, unless it is there as it would be created.
async fn begin(
    client: &Client,
    arguments: &ExplainArguments,
    name: &str,
) -> Result<Explanation, CommandError> {
    let source = client.campaign_status(&arguments.campaign).await?;
    let explanation = Explanation {
        campaign: arguments.campaign.clone(),
        budget: arguments.budget,
        seed: arguments.seed.unwrap_or_default(),
        exhaustive: arguments.exhaustive,
        repeats: arguments.repeats,
    };
    let campaign = client.report(&arguments.campaign).await?;
    Findings::can_be_of(&campaign, &explanation).map_err(usage)?;
    let rollouts = Rollouts::Explanation(explanation.clone());
    derived::create(client, source, name, rollouts).await?;
    Ok(explanation)
}
