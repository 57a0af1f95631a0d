//! Creates Python virtual environments.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::capture;

/// File that marks an environment as complete; holds the list of its packages.
const STAMP: &str = "installed.txt";

/// Creates a virtual environment with these packages, unless a complete environment exists.
pub(crate) fn environment(dir: &Path, packages: &[&str]) -> Result<&'static str> {
    let requirements = packages.join("\n");
    let stamp = dir.join(STAMP);
    if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == requirements) {
        return Ok("already there");
    }
    new_environment(dir)?;
    capture(pip(dir).args(packages))
        .context("install Python packages (is the package index reachable?)")?;
    std::fs::write(&stamp, requirements).with_context(|| format!("write {}", stamp.display()))?;
    Ok("installed")
}

/// Creates an empty virtual environment, replacing an existing environment.
pub(crate) fn new_environment(dir: &Path) -> Result<()> {
    let mut venv = Command::new("python3");
    capture(venv.args(["-m", "venv", "--clear"]).arg(dir))
        .context("make a virtual environment (Debian: `apt-get install python3-venv`)")?;
    Ok(())
}

/// Returns the environment's `pip install` command.
pub(crate) fn pip(dir: &Path) -> Command {
    let mut pip = Command::new(dir.join("bin/python"));
    pip.args(["-m", "pip", "install", "--quiet"]);
    pip.arg("--disable-pip-version-check");
    pip
}

/// Returns the folder of an interpreter's installed packages.
pub(crate) fn packages(python: &Path) -> Result<PathBuf> {
    let print = "import site; print(site.getsitepackages()[0])";
    capture(Command::new(python).args(["-c", print])).map(PathBuf::from)
}
