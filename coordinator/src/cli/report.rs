//! `coordinator report`: measures campaigns and files of result rows, and writes text, JSON, HTML,
//! figures and tables.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use benchmark::Suite;
use clap::Args;
use report::{Document, Subject, write_csv, write_parquet};

use super::command::{CommandError, Connection, print_line, usage};
use super::files::{AtomicFile, write_atomically, write_figures};

/// Printed below the long help.
const EXAMPLES: &str = "\
Examples:
  coordinator report first
  coordinator report first --full --html report.html --table outcomes.csv
  coordinator report goal --published libero_goal:openvla=97.1";

#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct ReportArguments {
    /// Names of campaigns; several are shown side by side.
    #[arg(required_unless_present = "from")]
    campaigns: Vec<String>,
    /// Folders that each hold the `rollouts.jsonl` of one policy, from the reference
    /// implementation or from `export`; or such files.
    #[arg(long, value_name = "DIR", num_args = 1..)]
    from: Vec<PathBuf>,
    /// Print every measure with its interval, and the meaning of each symbol.
    #[arg(long)]
    full: bool,
    /// Print JSON.
    #[arg(long, conflicts_with = "full")]
    json: bool,
    /// Write the report as one self-contained HTML page, which loads nothing from the network.
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Write the page's figures as SVG files into a folder.
    #[arg(long, value_name = "DIR")]
    figures: Option<PathBuf>,
    /// Write all outcomes, one row per configuration: FILE.csv or FILE.parquet.
    #[arg(long, value_name = "FILE", value_parser = parse_table)]
    table: Vec<(PathBuf, TableForm)>,
    /// Published nominal success of a policy, with which the report compares the measured one
    /// (the reproduction gate): over all suites, or, as `libero_goal:openvla=97.1`, of one suite.
    #[arg(long, value_name = "[SUITE:]POLICY=PERCENT", value_parser = parse_published)]
    published: Vec<Published>,
    #[command(flatten)]
    connection: Connection,
}

/// Published nominal success rate of a policy, from `--published`.
#[derive(Clone, Debug)]
struct Published {
    /// Suite of the rate; `None` if it was published over all suites.
    suite: Option<Suite>,
    policy: String,
    /// Success rate, a fraction.
    rate: f64,
}

/// File formats of the outcome table.
#[derive(Clone, Copy, Debug)]
enum TableForm {
    Csv,
    Parquet,
}

pub(super) async fn report(arguments: ReportArguments) -> Result<(), CommandError> {
    let mut subjects = Vec::new();
    if !arguments.campaigns.is_empty() {
        let client = arguments.connection.client()?;
        for campaign in &arguments.campaigns {
            subjects.push(client.report(campaign).await?);
        }
    }
    for path in &arguments.from {
        subjects.push(report::import(path).map_err(usage)?);
    }
    add_published(&mut subjects, &arguments.published).map_err(usage)?;
    let ctrl_flags = [
        ("--figures", arguments.figures.is_some()),
        ("--table", !arguments.table.is_empty()),
        ("--published", !arguments.published.is_empty()),
    ];
    let given_flag = ctrl_flags.into_iter().find(|(_, is_given)| *is_given);
    if let (Some((flag, _)), Some(protocol)) =
        (given_flag, subjects.iter().find_map(|subject| subject.protocol.as_deref()))
    {
        return Err(usage(anyhow!(
            "use {flag} for a campaign under {protocol}: the flag applies to LIBERO-CTRL's \
             measures, which campaigns of other benchmarks lack; leave it out, \
             or use --json in its place"
        )));
    }
    // Thousands of bootstrap resamplings block this thread, but no other task of the command runs.
    let document = Document::new(subjects).map_err(anyhow::Error::from)?;
    for (path, form) in &arguments.table {
        write_table(&document, path, *form)?;
    }
    if let Some(folder) = &arguments.figures {
        write_figures(&report::figures::all(&document), folder)?;
    }
    if let Some(path) = &arguments.html {
        write_atomically(path, report::page(&document).as_bytes())?;
        eprintln!("wrote the report to {}", path.display());
    }
    let text = match arguments.json {
        true => document.json().map_err(anyhow::Error::from)?,
        false if arguments.full => document.text(),
        false => document.brief(),
    };
    Ok(print_line(text.trim_end())?)
}

fn parse_published(text: &str) -> Result<Published, String> {
    let (policy, percent) = text
        .rsplit_once('=')
        .ok_or("write for example openvla=97.1, or libero_goal:openvla=97.1")?;
    let rate = match percent.parse::<f64>() {
        // No published policy succeeds in less than 1 %.
        Ok(share) if share > 0.0 && share < 1.0 => {
            let percent = format!("{:.1}", 100.0 * share);
            return Err(format!("write a percentage: did you mean {policy}={percent}?"));
        }
        Ok(percent) if (0.0..=100.0).contains(&percent) => percent / 100.0,
        _ => return Err(format!("`{percent}` is no percentage from 0 to 100")),
    };
    let of_suite =
        policy.split_once(':').and_then(|(suite, policy)| Some((suite.parse().ok()?, policy)));
    let (suite, policy) = match of_suite {
        Some((suite, policy)) => (Some(suite), policy),
        None => (None, policy),
    };
    Ok(Published { suite, policy: policy.to_owned(), rate })
}

fn add_published(subjects: &mut [Subject], published: &[Published]) -> anyhow::Result<()> {
    for Published { suite, policy, rate } in published {
        let mut has_report = false;
        let of_policy = subjects.iter_mut().filter(|subject| subject.policy == *policy);
        for subject in of_policy {
            match suite {
                Some(suite) => subject.published_by_suite.push((*suite, *rate)),
                None => subject.published_nominal = Some(*rate),
            }
            has_report = true;
        }
        if !has_report {
            let policies = subjects.iter().map(|subject| subject.policy.as_str());
            let policies: Vec<&str> = policies.collect();
            let policies = policies.join(", ");
            return Err(anyhow!("valid are {policies}"))
                .with_context(|| format!("use --published {policy}: no report has this policy"));
        }
    }
    Ok(())
}

fn parse_table(name: &str) -> Result<(PathBuf, TableForm), &'static str> {
    let path = PathBuf::from(name);
    match path.extension().and_then(OsStr::to_str) {
        Some("csv") => Ok((path, TableForm::Csv)),
        Some("parquet") => Ok((path, TableForm::Parquet)),
        _ => Err("name a file that ends with .csv or .parquet"),
    }
}

fn write_table(document: &Document, path: &Path, form: TableForm) -> anyhow::Result<()> {
    let mut file = AtomicFile::create(path)?;
    let written = match form {
        TableForm::Csv => write_csv(document, file.writer()),
        TableForm::Parquet => write_parquet(document, file.writer()),
    };
    written.with_context(|| format!("write {}", path.display()))?;
    file.finish()?;
    eprintln!("wrote the table to {}", path.display());
    Ok(())
}
