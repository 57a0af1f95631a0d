//! Python environments for the tests of the Python package and of the
//! documentation.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::capture;
use crate::step::step;

/// Packages that the tests compare the gateway's messages with: the client with
/// which openpi's robots query its servers, and vla-eval, whose model servers and
/// LIBERO benchmark they run.
const COMPARED_WITH: [&str; 2] = ["openpi-client==0.1.2", "vla-eval==0.8.0"];

/// Build requirement of `pip install ./policies`.
const BUILT_WITH: &str = "setuptools>=61";

/// Requirement of `docs/PYTHON.md` beside those of the package.
const NOTEBOOKS_NEED: &str = "pandas>=2";

/// Written into the folder of packages once all are there; holds what was wanted.
const STAMP: &str = "requirements-of.toml";

/// A virtual environment with the policies package, editable; returns its
/// interpreter.
pub(crate) fn environment(root: &Path, cache: &Path) -> Result<String> {
    let dir = cache.join("policies-venv");
    let python = dir.join("bin/python");
    if !python.exists() {
        capture(Command::new("python3").args(["-m", "venv"]).arg(&dir))
            .context("make a virtual environment (Debian: `apt-get install python3-venv`)")?;
    }
    let package = format!("{}[dev]", root.join("policies").display());
    capture(pip(&python, "install").arg("--editable").arg(package))?;
    // By themselves: the one asks for a NumPy before 2, which newer Pythons do not
    // have, the other for what films and draws; both do without.
    capture(pip(&python, "install").arg("--no-deps").args(COMPARED_WITH))?;
    Ok(python.display().to_string())
}

/// A folder with what the documentation's `pip install` downloads, so that its
/// commands work without a network.
pub(crate) fn packages(root: &Path, cache: &Path) -> Result<PathBuf> {
    let folder = cache.join("python-packages");
    step("packages for policies/README.md and docs/PYTHON.md", || {
        let manifest = root.join("policies/pyproject.toml");
        let requirements = std::fs::read_to_string(&manifest)
            .with_context(|| format!("read {}", manifest.display()))?;
        let wanted = format!("{requirements}# {NOTEBOOKS_NEED}\n");
        let stamp = folder.join(STAMP);
        if std::fs::read_to_string(&stamp).is_ok_and(|there| there == wanted) {
            return Ok("already there");
        }
        let mut download = pip(Path::new("python3"), "download");
        download.arg("--dest").arg(&folder);
        download.arg(root.join("policies"));
        capture(download.args([BUILT_WITH, NOTEBOOKS_NEED]))?;
        std::fs::write(&stamp, wanted).with_context(|| format!("write {}", stamp.display()))?;
        Ok("downloaded")
    })?;
    Ok(folder)
}

fn pip(python: &Path, command: &str) -> Command {
    let mut pip = Command::new(python);
    pip.args(["-m", "pip", command, "--quiet"]);
    pip.arg("--disable-pip-version-check");
    pip
}
