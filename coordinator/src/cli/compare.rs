//! `coordinator compare`: paired comparisons of policies over the rollouts that both of a pair have
//! run.

use anyhow::anyhow;
use clap::Args;
use report::{Document, FamilyComparison};

use super::command::{CommandError, Connection, print_line, usage};
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
        return match arguments.json {
            true => json::print(&comparison),
            false => Ok(print_line(comparison.text().trim_end())?),
        };
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
        return match arguments.json {
            true => json::print(&document.comparisons().iter().flatten().collect::<Vec<_>>()),
            false => Ok(print_line(document.pairs().trim_end())?),
        };
    };
    match arguments.json {
        true => json::print(comparison),
        false => Ok(print_line(comparison.text().trim_end())?),
    }
}
