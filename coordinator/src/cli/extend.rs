//! `coordinator campaign extend`: a campaign gets the rollouts that it lacks of a larger design, or
//! further rows; what it has measured is not run again.

use std::path::PathBuf;

use anyhow::{Context, anyhow};
use benchmark::{Level, MAX_REPLICATES, Rollouts};
use clap::{ArgGroup, Args};
use coordinator::client::Service;
use proto::coordinator::{AppendRowsRequest, AppendedRow};
use queue::Created;
use terminal::{counted, number};

use super::command::{CommandError, Connection, print_line, usage};
use super::create::{configs, parse_names, tasks};
use super::files::read_manifest;

/// Printed below the long help.
const EXAMPLES: &str = "\
Examples:
  coordinator campaign extend first --configs 4-9
  coordinator campaign extend imported --rows further.jsonl";

#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES)]
#[command(group = ArgGroup::new("more").required(true).multiple(true))]
pub(super) struct ExtendArguments {
    /// Name of the campaign.
    campaign: String,
    /// Further tasks: `libero_object/0,libero_spatial/0-3`, a suite, or `all`.
    #[arg(long, group = "more", value_delimiter = ',')]
    tasks: Vec<String>,
    /// Further levels: L0, L1, L2, L3, or any radius, such as `r2.5`.
    #[arg(long, group = "more", value_delimiter = ',')]
    levels: Vec<String>,
    /// Further configurations: `0-9`, `0,3,5-7`.
    #[arg(long, group = "more", value_delimiter = ',')]
    configs: Vec<String>,
    /// Number of runs of every rollout, those of the campaign included.
    #[arg(long, group = "more", value_parser = number(1..=MAX_REPLICATES, "times"))]
    replicates: Option<u32>,
    /// Further rows for a campaign of rows; `-` reads standard input.
    #[arg(long, group = "more", value_name = "FILE", conflicts_with_all = ["tasks", "levels", "configs", "replicates"])]
    rows: Option<PathBuf>,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn extend(arguments: ExtendArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let name = &arguments.campaign;
    let mut request = AppendRowsRequest { campaign: name.clone(), ..AppendRowsRequest::default() };
    if let Some(path) = &arguments.rows {
        for row in read_manifest(path)? {
            let manifest_row = serde_json::to_string(&row).map_err(anyhow::Error::from)?;
            request.rows.push(AppendedRow { manifest_row, replicates: Vec::new() });
        }
    } else {
        let mut larger = client.specification(name).await?;
        let Rollouts::Design(mut design) = larger.rollouts else {
            return Err(usage(anyhow!(
                "extend campaign `{name}`: it has no design; add rows to a campaign of rows \
                 with --rows"
            )));
        };
        design.tasks.extend(tasks(&arguments.tasks).map_err(usage)?);
        design.levels.extend(parse_names::<Level>(&arguments.levels).map_err(usage)?);
        design.configs.extend(configs(&arguments.configs).map_err(usage)?);
        larger.rollouts = Rollouts::Design(design.in_order());
        larger.replicates = arguments.replicates.unwrap_or(larger.replicates);
        larger.check().map_err(usage)?;
        request.spec = serde_json::to_string(&larger).context("write the specification")?;
    }
    let added: Created = client.ask(request, Service::append_rows).await?;
    let (new, all) = (counted(added.jobs_added, "rollout"), counted(added.jobs_total, "rollout"));
    Ok(print_line(&format!("campaign {name} extended by {new}: {all}"))?)
}
