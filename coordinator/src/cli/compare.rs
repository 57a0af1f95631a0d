//! `coordinator compare`: paired comparisons of policies over the rollouts that both of a pair have
//! run.

use anyhow::anyhow;
use clap::Args;
use report::{Document, FamilyComparison};

use super::command::{CommandError, Connection, usage};
use super::json;

#[derive(Args, Debug)]
pub(super) struct CompareArguments {
    /// The policies, each a campaign's name, or a folder with a `rollouts.jsonl`, or that file,
    /// whose path has a `/`. Of two, A and B, the difference is A - B; of more, every pair is
    /// compared.
    #[arg(value_name = "CAMPAIGN_OR_PATH", num_args = 2.., required = true)]
    sources: Vec<String>,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn compare(arguments: CompareArguments) -> Result<(), CommandError> {
    let subjects = arguments.connection.subjects(&arguments.sources).await?;
    if let [a, b] = subjects.as_slice()
        && let Some(comparison) = FamilyComparison::of(a, b).map_err(anyhow::Error::from)?
    {
        return json::print_or(arguments.json, &comparison, || comparison.text());
    }
    if subjects.iter().any(|subject| subject.protocol.is_some()) {
        return Err(usage(anyhow!(
            "compare a campaign of LIBERO's family with one of LIBERO-CTRL, or more than two: \
             name two campaigns of one benchmark"
        )));
    }
    let document = Document::new(subjects).map_err(anyhow::Error::from)?;
    let [Ok(comparison)] = document.comparisons() else {
        if let [Err(refused)] = document.comparisons() {
            return Err(anyhow::Error::from(refused.clone()).into());
        }
        let pairs = document.comparisons().iter().flatten().collect::<Vec<_>>();
        return json::print_or(arguments.json, &pairs, || document.pairs());
    };
    json::print_or(arguments.json, comparison, || comparison.text())
}
