//! `coordinator export`: committed results as rows with the reference's columns.

use std::io::{BufWriter, Write};
use std::path::PathBuf;

use anyhow::{Context, anyhow};
use clap::Args;
use coordinator::client::{Client, Service};
use proto::coordinator::ExportRequest;
use report::write_results_parquet;
use terminal::counted;

use super::command::{CommandError, Connection, usage};
use super::files::AtomicFile;

/// Printed below the long help.
const EXAMPLES: &str = "\
Examples:
  coordinator export first --format jsonl --output first.jsonl
  coordinator export first --format jsonl | head -1
  coordinator export first --format parquet --output first.parquet
  coordinator report first --table outcomes.csv        # one row per configuration";

#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct ExportArguments {
    /// Name of the campaign.
    campaign: String,
    /// `jsonl`, rows with the reference's columns; or `parquet`, the same rows as a table, with
    /// --output. For a row per configuration there is `coordinator report CAMPAIGN --table`.
    #[arg(long, value_parser = format)]
    format: Format,
    /// File to write; standard output if omitted.
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    connection: Connection,
}

#[derive(Clone, Copy, Debug)]
enum Format {
    Jsonl,
    Parquet,
}

pub(super) async fn export(arguments: ExportArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    match &arguments.output {
        None if matches!(arguments.format, Format::Parquet) => {
            return Err(usage(anyhow!(
                "export as parquet: a Parquet table cannot be printed; name a file with --output"
            )));
        }
        None => {
            let mut stdout = BufWriter::new(std::io::stdout().lock());
            write_lines(&client, &arguments.campaign, &mut stdout).await?;
        }
        Some(path) => {
            let mut file = AtomicFile::create(path)?;
            let rows = match arguments.format {
                Format::Jsonl => write_lines(&client, &arguments.campaign, file.writer()).await?,
                Format::Parquet => write_table(&client, &arguments.campaign, file.writer()).await?,
            };
            file.finish()?;
            eprintln!("wrote {} to {}", counted(rows, "result"), path.display());
        }
    }
    Ok(())
}

fn format(name: &str) -> Result<Format, String> {
    match name {
        "jsonl" => Ok(Format::Jsonl),
        "parquet" => Ok(Format::Parquet),
        "csv" => {
            Err("`coordinator report CAMPAIGN --table FILE.csv` writes outcomes in this format; \
             `export` writes jsonl and parquet"
                .to_owned())
        }
        _ => Err("write jsonl or parquet".to_owned()),
    }
}

async fn write_table(
    client: &Client,
    campaign: &str,
    out: &mut (impl Write + Send),
) -> Result<u64, CommandError> {
    let request = ExportRequest { campaign: campaign.to_owned() };
    let mut lines = client.call(request, Service::export).await?;
    let mut rows = Vec::new();
    while let Some(line) = client.next(&mut lines).await? {
        rows.push(serde_json::from_str(&line.json).context("read a result")?);
    }
    let count = rows.len() as u64;
    write_results_parquet(rows, out).context("write the results")?;
    Ok(count)
}

async fn write_lines(
    client: &Client,
    campaign: &str,
    out: &mut impl Write,
) -> Result<u64, CommandError> {
    let request = ExportRequest { campaign: campaign.to_owned() };
    let mut lines = client.call(request, Service::export).await?;
    let mut rows = 0;
    while let Some(line) = client.next(&mut lines).await? {
        writeln!(out, "{}", line.json).context("write the results")?;
        rows += 1;
    }
    out.flush().context("write the results")?;
    Ok(rows)
}
