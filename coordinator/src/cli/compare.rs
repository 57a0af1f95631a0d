//! `coordinator compare`: paired comparison of two policies over the rollouts that both have run.

use anyhow::anyhow;
use clap::Args;
use report::{Comparison, Document, FamilyComparison};

use super::command::{CommandError, Connection, print_line, usage};
use super::json;

#[derive(Args, Debug)]
pub(super) struct CompareArguments {
    /// The two policies, A and B, each a campaign's name, or a folder with a `rollouts.jsonl`, or
    /// that file, whose path has a `/`; the difference is A - B.
    #[arg(value_name = "CAMPAIGN_OR_PATH", num_args = 2, required = true)]
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
        return match arguments.json {
            true => json::print(&comparison),
            false => Ok(print_line(comparison.text().trim_end())?),
        };
    }
    if subjects.iter().any(|subject| subject.protocol.is_some()) {
        return Err(usage(anyhow!(
            "compare a campaign of LIBERO's family with one of LIBERO-CTRL: they have no rollout in \
             common; name two campaigns of one benchmark"
        )));
    }
    let document = Document::new(subjects).map_err(anyhow::Error::from)?;
    let [a, b] = document.analyses.as_slice() else {
        unreachable!("one analysis per subject");
    };
    let setups = [&a.subject.setups, &b.subject.setups];
    let comparison = Comparison::of([a, b], setups).map_err(anyhow::Error::from)?;
    match arguments.json {
        true => json::print(&comparison),
        false => Ok(print_line(comparison.text().trim_end())?),
    }
}
