//! `coordinator manifest`: expands, checks and compares manifest files without a coordinator. The
//! manifest format and the comparison are implemented in `benchmark`.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use benchmark::{Design, DesignVersion, ManifestRow, manifest};
use clap::{ArgGroup, Args, Subcommand, ValueEnum};
use terminal::counted;

use super::command::{CommandError, failure, print, print_line, usage};
use super::files::{input_name, read_manifest, read_spec, write_atomically};

#[derive(Debug, Subcommand)]
pub(super) enum ManifestCommand {
    /// Write the rows of a design as JSON Lines, in the order in which they
    /// would run.
    Expand(ExpandArguments),
    /// Check a manifest line by line.
    Check {
        /// The manifest; `-` reads standard input.
        file: PathBuf,
    },
    /// List the rows and columns in which two manifests differ.
    Diff {
        /// The first manifest.
        first: PathBuf,
        /// The second manifest.
        second: PathBuf,
    },
}

#[derive(Args, Debug)]
#[command(group = ArgGroup::new("source").required(true).args(["version", "spec"]))]
pub(super) struct ExpandArguments {
    /// A published design of LIBERO-CTRL.
    #[arg(long, value_name = "VERSION", value_parser = ["v0.1"])]
    version: Option<String>,
    /// File of a campaign's specification in JSON, to expand its design; `-` reads standard input.
    #[arg(long, value_name = "FILE")]
    spec: Option<PathBuf>,
    /// Rows to write: `nominal`; `eval`, the perturbed rows; or `all`.
    #[arg(long, value_enum, default_value_t = Split::All)]
    split: Split,
    /// File to write; standard output if omitted.
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Split {
    // Accepts the name that the released files use.
    #[value(alias = "clean")]
    Nominal,
    Eval,
    All,
}

pub(super) fn manifest(command: ManifestCommand) -> Result<(), CommandError> {
    match command {
        ManifestCommand::Expand(arguments) => expand(&arguments),
        ManifestCommand::Check { file } => check(&file),
        ManifestCommand::Diff { first, second } => diff(&first, &second),
    }
}

fn expand(arguments: &ExpandArguments) -> Result<(), CommandError> {
    let rows = match &arguments.spec {
        Some(path) => read_spec(path)?.expand().map_err(usage)?,
        None => Design::v0_1().expand().context("expand v0.1")?,
    };
    let is_wanted = |row: &&ManifestRow| match arguments.split {
        Split::All => true,
        Split::Nominal => is_nominal(row),
        Split::Eval => !is_nominal(row),
    };
    let rows: Vec<&ManifestRow> = rows.iter().filter(is_wanted).collect();
    let text = manifest::to_text(rows.iter().copied());
    let Some(path) = &arguments.output else {
        return Ok(print(&text)?);
    };
    write_atomically(path, text.as_bytes())?;
    let rows = counted(rows.len() as u64, "row");
    eprintln!("wrote {rows} to {}", path.display());
    Ok(())
}

fn check(path: &Path) -> Result<(), CommandError> {
    let rows = read_manifest(path)?;
    let nominal = rows.iter().filter(|row| is_nominal(row)).count();
    Ok(print_line(&format!(
        "{}: {}, {nominal} nominal and {} perturbed; design {}",
        input_name(path),
        counted(rows.len() as u64, "row"),
        rows.len() - nominal,
        DesignVersion::of_manifest(&rows)
    ))?)
}

fn diff(first: &Path, second: &Path) -> Result<(), CommandError> {
    let (left, right) = (read_manifest(first)?, read_manifest(second)?);
    let differences = manifest::diff(&left, &right);
    for difference in &differences {
        print_line(&difference.to_string())?;
    }
    let (first, second) = (input_name(first), input_name(second));
    match differences.len() {
        0 => Ok(print_line(&format!(
            "{first} and {second} have the same {}",
            counted(left.len() as u64, "row")
        ))?),
        count => Err(failure(anyhow!(
            "compare {first} and {second}: they differ in {}",
            counted(count as u64, "place")
        ))),
    }
}

fn is_nominal(row: &ManifestRow) -> bool {
    let variant = row.id.variant();
    match variant.filter(|name| name.benchmark().is_some()) {
        Some(variant) => variant.is_unperturbed(),
        None => row.id.config().is_none(),
    }
}
