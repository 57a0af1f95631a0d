//! Tests the launcher of `deploy/ray` on Ray itself.

use std::path::Path;
use std::process::Command;

use anyhow::Result;

use crate::process::run as run_command;
use crate::step::step;
use crate::venv::environment;

/// Packages of the tests, installed into their own environment.
const TESTED_WITH: [&str; 2] = ["ray==2.60.0", "pytest>=7"];

/// Runs the tests if Ray can be installed.
pub(crate) fn test(root: &Path, cache: &Path, programs: &Path) -> Result<()> {
    let dir = cache.join("ray");
    let mut problem = None;
    step("Ray for the tests of deploy/ray", || {
        // If Ray is unavailable, these tests are skipped with a message.
        let outcome = environment(&dir, &TESTED_WITH).map(str::to_owned);
        Ok(outcome.unwrap_or_else(|error| problem.insert(format!("none: {error:#}")).clone()))
    })?;
    if problem.is_some() {
        println!("  skipped deploy/ray/tests: no Ray");
        return Ok(());
    }
    let mut pytest = Command::new(dir.join("bin/python"));
    pytest
        .args(["-m", "pytest", "--quiet", "-rfs", "-p", "no:cacheprovider"])
        .arg(root.join("deploy/ray/tests"))
        .env("ROLLOUT_PROGRAMS", programs);
    run_command(&mut pytest)
}
