//! Python environments for the tests of the policies package and of the documentation.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::capture;
use crate::step::step;
use crate::venv::{new_environment, pip};
use crate::wheel::SETUPTOOLS;

/// Packages whose messages the tests compare with the gateway's: the client with which openpi's
/// robots query its servers, and vla-eval with its model servers and LIBERO benchmark.
const COMPARED_WITH: [&str; 2] = ["openpi-client==0.1.2", "vla-eval==0.8.0"];

/// Requirement of `docs/PYTHON.md` beyond the package's requirements.
const NOTEBOOK_REQUIREMENT: &str = "pandas>=2";

/// File that marks a folder of packages as complete; holds the list of their requirements.
const STAMP: &str = "requirements-of.toml";

/// Creates a virtual environment with the policies package in editable mode; returns its
/// interpreter.
pub(crate) fn policies(root: &Path, cache: &Path) -> Result<String> {
    let dir = cache.join("policies-venv");
    let python = dir.join("bin/python");
    if !python.exists() {
        new_environment(&dir)?;
    }
    let package = format!("{}[dev]", root.join("policies").display());
    capture(pip(&dir).arg("--editable").arg(package))?;
    // Without dependencies, which the tests do not need: openpi-client requires NumPy below 2,
    // which newer Pythons lack, and vla-eval requires packages for videos and rendering.
    capture(pip(&dir).arg("--no-deps").args(COMPARED_WITH))?;
    Ok(python.display().to_string())
}

/// Downloads the packages of the documentation's `pip install` into a folder, so that its commands
/// work without a network.
pub(crate) fn packages(root: &Path, cache: &Path) -> Result<PathBuf> {
    let folder = cache.join("python-packages");
    step("packages for policies/README.md and docs/PYTHON.md", || {
        let manifest = root.join("policies/pyproject.toml");
        let requirements = std::fs::read_to_string(&manifest)
            .with_context(|| format!("read {}", manifest.display()))?;
        let expected = format!("{requirements}# {NOTEBOOK_REQUIREMENT}\n");
        let stamp = folder.join(STAMP);
        if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == expected) {
            return Ok("already there");
        }
        let mut download = Command::new("python3");
        download.args(["-m", "pip", "download", "--quiet", "--disable-pip-version-check"]);
        download.arg("--dest").arg(&folder);
        download.arg(root.join("policies"));
        capture(download.args([SETUPTOOLS, NOTEBOOK_REQUIREMENT]))?;
        std::fs::write(&stamp, expected).with_context(|| format!("write {}", stamp.display()))?;
        Ok("downloaded")
    })?;
    Ok(folder)
}
