//! A small campaign from end to end.

use std::path::Path;

use anyhow::Result;

/// How the demo runs.
#[derive(clap::Args)]
pub(crate) struct Options {}

/// Runs it.
pub(crate) fn run(_root: &Path, _options: &Options) -> Result<()> {
    Ok(())
}
