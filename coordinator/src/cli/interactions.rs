//! `coordinator interactions`: effects of the axes alone and in combination, for campaigns that run
//! every subset of the axes.

use clap::Args;
use report::AxisInteractions;

use super::command::{CommandError, Connection};
use super::json;

#[derive(Args, Debug)]
pub(super) struct InteractionsArguments {
    /// Campaign that runs all subsets of the axes, created by `campaign create --subsets all` or
    /// by `explain --exhaustive`.
    campaign: String,
    /// Print JSON, as docs/JSON.md describes it.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn interactions(arguments: InteractionsArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let subject = client.report(&arguments.campaign).await?;
    let interactions = AxisInteractions::of(&subject).map_err(anyhow::Error::from)?;
    json::print_or(arguments.json, &interactions, || interactions.text())
}
