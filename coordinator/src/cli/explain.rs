//! `coordinator explain`: minimal subsets of the axes that change an outcome.

use std::collections::BTreeMap;

use anyhow::{Context, anyhow};
use benchmark::{CampaignSpec, Explanation, ManifestRow, Purpose, Record, RolloutId};
use clap::Args;
use paired::adaptive::subsets::{Addition, additions};
use report::{Findings, Subject};
use terminal::{number, number_from};

use super::command::{CommandError, Connection, usage};
use super::create::{RECORDS, enum_parser};
use super::json;
use super::search::{CreateFlags, NextRow, Search};

/// Most replicates of one subset.
const MAX_REPEATS: u32 = 1_000;

/// Printed below the long help.
const EXAMPLES: &str = "\
Examples:
  coordinator explain first                  # the findings, or the rollouts needed
  coordinator explain first --create
  coordinator explain first --dry-run --budget 200";

#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct ExplainArguments {
    /// Campaign whose emergent failures and compensated successes are explained once it
    /// is finished.
    campaign: String,
    /// Name of the campaign that runs the subsets. [default: CAMPAIGN-explained]
    #[arg(long)]
    name: Option<String>,
    /// Maximum number of rollouts, spent on transitions in random order; if omitted, every
    /// transition is explained.
    #[arg(long, value_name = "N", requires = "CreateFlags",
        value_parser = number(1..=u32::MAX, "rollouts"))]
    budget: Option<u32>,
    /// Seed of the random order in which transitions are explained. [default: 0]
    #[arg(long, requires = "CreateFlags", value_parser = number_from(0_u64, ""))]
    seed: Option<u64>,
    /// Run every subset, not only those that are needed to find the minimal ones.
    #[arg(long, requires = "CreateFlags")]
    exhaustive: bool,
    /// For a stochastic policy: maximum number of replicates for the verdict on a subset, not
    /// counting the outcomes of CAMPAIGN. With six axes, N must be at least 12. If omitted, one
    /// rollout decides.
    #[arg(long, value_name = "N", requires = "CreateFlags",
        value_parser = number(2..=MAX_REPEATS, "replicates"))]
    repeats: Option<u32>,
    /// Subsets to film: `none`; `transitions`, those that show the explanation, filmed afterwards
    /// by `worker film`; `failures`; or `all`. [default: as CAMPAIGN]
    #[arg(long, requires = "CreateFlags", value_parser = enum_parser::<Record>(RECORDS))]
    record: Option<Record>,
    #[command(flatten)]
    create: CreateFlags,
    /// Print JSON, as docs/JSON.md describes it.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn explain(arguments: ExplainArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let default_name = || format!("{}-explained", arguments.campaign);
    let name = arguments.name.clone().unwrap_or_else(default_name);
    let explanation = Explanation {
        campaign: arguments.campaign.clone(),
        budget: arguments.budget,
        seed: arguments.seed.unwrap_or_default(),
        exhaustive: arguments.exhaustive,
        repeats: arguments.repeats,
    };
    let search = Search {
        source: &arguments.campaign,
        name: &name,
        command: "explain",
        sought: "transition",
        purpose: Purpose::Explanation(explanation.clone()),
        record: arguments.record,
        must_exist: arguments.json,
    };
    let prospect = |source: &Subject| Findings::prospect(source, &explanation).map_err(usage);
    let next = |subject: &Subject, source: &CampaignSpec| next(subject, source, &explanation);
    let Some(subject) = search.run_or_propose(&client, arguments.create, prospect, next).await?
    else {
        return Ok(());
    };
    let no_findings =
        || anyhow!("show the findings of `{name}`: the campaign explains no other campaign");
    let findings = Findings::of(&subject).map_err(usage)?.ok_or_else(no_findings)?;
    json::print_or(arguments.json, &findings, || findings.text())
}

/// Returns the next rollouts: the rows of the explained campaign, restricted to some axes.
fn next(
    explaining: &Subject,
    source: &CampaignSpec,
    explanation: &Explanation,
) -> anyhow::Result<Vec<NextRow>> {
    let records = explaining.derived.as_ref().map_or(&[][..], |derived| &derived.records);
    let rows = source.expand()?.into_iter().map(|row| (row.id, row));
    let rows: BTreeMap<RolloutId, ManifestRow> = rows.collect();
    let additions = additions(records, &explaining.records, explanation).into_iter();
    let row = |Addition { simultaneous, axes, replicates }| {
        let row = rows.get(&simultaneous);
        let row = row.with_context(|| format!("find {simultaneous} in the explained campaign"))?;
        let row = if axes == row.axes() { row.clone() } else { row.only(axes)? };
        Ok((row, replicates.collect()))
    };
    additions.map(row).collect()
}
