//! `coordinator export`: committed results as the reference's rows.

use std::io::{BufWriter, Write};
use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use coordinator::client::{Client, Service};
use proto::coordinator::ExportRequest;
use terminal::counted;

use super::command::{CommandError, Connection};
use super::files::WholeFile;

/// Printed below the long help.
const EXAMPLES: &str = "\
Examples:
  coordinator export first --format jsonl --output first.jsonl
  coordinator export first --format jsonl | head -1
  coordinator report first --table outcomes.csv        # one row per configuration";

#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct ExportArguments {
    /// Name of the campaign.
    campaign: String,
    /// `jsonl`, the reference's result rows. For CSV and Parquet there is
    /// `coordinator report CAMPAIGN --table FILE.csv`.
    #[arg(long, value_parser = format)]
    format: String,
    /// File to write; standard output without it.
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn export(arguments: ExportArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    match &arguments.output {
        None => {
            let mut stdout = BufWriter::new(std::io::stdout().lock());
            write_lines(&client, &arguments.campaign, &mut stdout).await?;
        }
        Some(path) => {
            let mut file = WholeFile::create(path)?;
            let rows = write_lines(&client, &arguments.campaign, file.writer()).await?;
            file.finish()?;
            eprintln!("wrote {} to {}", counted(rows, "result"), path.display());
        }
    }
    Ok(())
}

fn format(name: &str) -> Result<String, String> {
    match name {
        "jsonl" => Ok(name.to_owned()),
        "csv" | "parquet" => Err(format!(
            "`coordinator report CAMPAIGN --table FILE.{name}` writes outcomes in this format; \
             `export` writes jsonl"
        )),
        _ => Err("write jsonl".to_owned()),
    }
}

async fn write_lines(
    client: &Client,
    campaign: &str,
    out: &mut impl Write,
) -> Result<u64, CommandError> {
    let request = ExportRequest {
        campaign: campaign.to_owned(),
    };
    let mut lines = client.call(request, Service::export).await?;
    let mut rows = 0;
    while let Some(line) = client.next(&mut lines).await? {
        writeln!(out, "{}", line.json).context("write the results")?;
        rows += 1;
    }
    out.flush().context("write the results")?;
    Ok(rows)
}
