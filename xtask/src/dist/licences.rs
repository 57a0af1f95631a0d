//! Licences of everything in the archive; cargo-about collects those of the crates.

use std::path::Path;

use anyhow::{Context, Result};

use crate::cargo::cargo;
use crate::packages::WHEELS;
use crate::process::capture;

pub(super) fn tool(root: &Path) -> Result<()> {
    capture(cargo(root).args(["about", "--version"]))
        .map(drop)
        .context("find cargo-about (`cargo install --locked cargo-about --features cli`)")
}

/// Writes the licence texts of crates and of the wheels that files come from.
pub(super) fn write(root: &Path, cache: &Path, to: &Path) -> Result<()> {
    let mut text = String::new();
    for wheel in &WHEELS {
        text += &format!("{}\n\n{}\n\n", wheel.requirement, wheel.licences(cache)?);
    }
    let about = ["about", "generate", "--workspace", "--locked", "--fail", "about.hbs"];
    text += &capture(cargo(root).args(about))?;
    std::fs::write(to.join("THIRD-PARTY-LICENSES.txt"), text + "\n")?;
    Ok(())
}
