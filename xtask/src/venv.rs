//! Creates Python virtual environments.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::capture;
use crate::setup::remedy;
use crate::step::step;

/// File that marks an environment as complete; holds the list of its packages.
const STAMP: &str = "installed.txt";

/// Creates a virtual environment with these packages, unless a complete environment exists.
pub(crate) fn environment(dir: &Path, packages: &[&str]) -> Result<&'static str> {
    with_undeclared(dir, packages, &[])
}

/// Creates an environment, as [`environment`], with further packages, but without those that
/// `alone` declare as their requirements.
pub(crate) fn with_undeclared(
    dir: &Path,
    packages: &[&str],
    alone: &[&str],
) -> Result<&'static str> {
    let requirements = [packages, alone].concat().join("\n");
    let stamp = dir.join(STAMP);
    if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == requirements) {
        return Ok("already there");
    }
    new_environment(dir)?;
    for (options, packages) in [(&[][..], packages), (&["--no-deps"], alone)] {
        if !packages.is_empty() {
            capture(pip(dir).args(options).args(packages))
                .context("install Python packages (is the package index reachable?)")?;
        }
    }
    std::fs::write(&stamp, requirements).with_context(|| format!("write {}", stamp.display()))?;
    Ok("installed")
}

/// Creates a virtual environment for tests that are skipped, with a message, without it; returns
/// the folder of its programs.
pub(crate) fn optional(title: &str, dir: &Path, packages: &[&str]) -> Option<PathBuf> {
    let mut problem = None;
    let described = step(title, || {
        let outcome = environment(dir, packages).map(str::to_owned);
        Ok(outcome.unwrap_or_else(|error| problem.insert(format!("none: {error:#}")).clone()))
    });
    (described.is_ok() && problem.is_none()).then(|| dir.join("bin"))
}

pub(crate) fn new_environment(dir: &Path) -> Result<()> {
    let mut venv = Command::new("python3");
    capture(venv.args(["-m", "venv", "--clear"]).arg(dir))
        .with_context(|| format!("make a virtual environment ({})", remedy("pip")))?;
    Ok(())
}

pub(crate) fn pip(dir: &Path) -> Command {
    let mut pip = Command::new(dir.join("bin/python"));
    pip.args(["-m", "pip", "install", "--quiet"]);
    pip.arg("--disable-pip-version-check");
    pip
}

/// Returns the folder of an interpreter's installed packages.
pub(crate) fn site_packages(python: &Path) -> Result<PathBuf> {
    let print = "import site; print(site.getsitepackages()[0])";
    capture(Command::new(python).args(["-c", print])).map(PathBuf::from)
}
