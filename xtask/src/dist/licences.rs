//! Licences of everything in the archive; cargo-about collects those of the crates.

use std::path::Path;

use anyhow::{Context, Result};

use crate::cargo::cargo;
use crate::packages::WHEELS;
use crate::process::capture;

const COMPILER: &str = "of GCC, GPL-3.0-or-later WITH GCC-exception-3.1: by the Free Software \
    Foundation, copied unaltered from the system on which this archive was built. The GCC Runtime \
    Library Exception 3.1 lets programs of any licence be distributed with it. The texts: \
    https://www.gnu.org/licenses/gpl-3.0.txt and \
    https://www.gnu.org/licenses/gcc-exception-3.1.txt. The source: https://gcc.gnu.org.";

/// Checks that the collector is installed.
pub(super) fn tool(root: &Path) -> Result<()> {
    capture(cargo(root).args(["about", "--version"]))
        .map(drop)
        .context("find cargo-about (`cargo install --locked cargo-about --features cli`)")
}

/// Writes the licence texts of crates, wheels and the compiler's libraries.
pub(super) fn write(root: &Path, cache: &Path, libraries: &[&str], to: &Path) -> Result<()> {
    let mut text = String::new();
    for library in libraries {
        text += &format!("{library}, {COMPILER}\n\n");
    }
    for wheel in &WHEELS {
        text += &format!("{}\n\n{}\n\n", wheel.requirement, wheel.licences(cache)?);
    }
    let about = ["about", "generate", "--workspace", "--locked", "--fail", "about.hbs"];
    text += &capture(cargo(root).args(about))?;
    std::fs::write(to.join("THIRD-PARTY-LICENSES.txt"), text + "\n")?;
    Ok(())
}
