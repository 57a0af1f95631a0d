//! `cargo xtask check`, to be run after every edit: format, lints, types of Python, documentation
//! and the tests that need neither programs nor scenes.

use std::path::Path;

use anyhow::Result;

use crate::cargo::cargo;
use crate::lint;
use crate::process::capture;
use crate::setup;
use crate::step::step;

/// Runs every part, and stops at the first failure.
pub(crate) fn run(root: &Path) -> Result<()> {
    let cache = setup::run(root)?;
    println!("Checking");
    step("format", || {
        capture(cargo(root).args(["fmt", "--all", "--check"])).map(|_| "as rustfmt writes it")
    })?;
    lint::run(root, &cache)?;
    step("lints", || {
        let clippy = ["clippy", "--workspace", "--all-targets", "--quiet"];
        capture(cargo(root).args(clippy).args(["--", "--deny", "warnings"])).map(|_| "none")
    })?;
    step("documentation", || documentation(root))?;
    step("unit tests", || {
        // The profile `check` of .config/nextest.toml selects the tests.
        let tests = ["nextest", "run", "--workspace", "--profile", "check"];
        let lines = capture(cargo(root).args(tests).args(["--final-status-level", "none"]))?;
        Ok(lines.lines().last().unwrap_or("passed").trim().to_owned())
    })?;
    Ok(())
}

/// Builds rustdoc of all crates; a broken link or a malformed example is an error.
pub(crate) fn documentation(root: &Path) -> Result<&'static str> {
    let mut doc = cargo(root);
    doc.args(["doc", "--workspace", "--no-deps", "--quiet", "--document-private-items"]);
    capture(doc.env("RUSTDOCFLAGS", "--deny warnings")).map(|_| "no warnings")
}
