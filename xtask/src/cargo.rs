//! Calling cargo, and finding what it built.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Result;

use crate::process::run;

/// Cargo in the workspace.
pub(crate) fn cargo(root: &Path) -> Command {
    let program = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut cargo = Command::new(program);
    cargo.current_dir(root);
    cargo
}

/// Builds all programs and returns the folder that they are in.
pub(crate) fn build_programs(root: &Path) -> Result<PathBuf> {
    println!("Building the programs");
    run(cargo(root).args(["build", "--workspace", "--bins", "--exclude", "xtask"]))?;
    // This program was built by the same cargo into the same folder.
    let own = std::env::current_exe()?;
    Ok(own
        .parent()
        .map_or_else(|| root.join("target/debug"), Path::to_owned))
}
