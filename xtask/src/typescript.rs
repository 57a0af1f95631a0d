//! Builds the policy server in TypeScript, the example of a server in another language.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::capture;
use crate::setup::remedy;
use crate::step::step;

/// File that marks a folder of packages as complete; holds the lock file that they were installed
/// from.
const STAMP: &str = "node_modules/.installed-from";

/// Builds the server and returns the script for `node`; `None` if npm is not installed, in which
/// case the server's tests report that they are skipped.
pub(crate) fn build(root: &Path) -> Result<Option<PathBuf>> {
    let folder = root.join("policies/typescript");
    if capture(Command::new("npm").arg("--version")).is_err() {
        step("TypeScript policy", || Ok(format!("skipped: no npm ({})", remedy("npm"))))?;
        return Ok(None);
    }
    step("packages for policies/typescript", || install(&folder))?;
    step("TypeScript policy", || capture(npm(&folder).args(["run", "build"])).map(|_| "built"))?;
    Ok(Some(folder.join("dist/src/main.js")))
}

fn install(folder: &Path) -> Result<&'static str> {
    let lock_file = folder.join("package-lock.json");
    let lock = std::fs::read_to_string(&lock_file)
        .with_context(|| format!("read {}", lock_file.display()))?;
    let stamp = folder.join(STAMP);
    if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == lock) {
        return Ok("already there");
    }
    capture(npm(folder).args(["ci", "--ignore-scripts", "--no-audit", "--no-fund"]))?;
    std::fs::write(&stamp, lock).with_context(|| format!("write {}", stamp.display()))?;
    Ok("installed")
}

fn npm(folder: &Path) -> Command {
    let mut npm = Command::new("npm");
    npm.current_dir(folder);
    npm
}
