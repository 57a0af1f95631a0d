//! `cargo xtask bench build`: measures how long newcomers and contributors wait for three results:
//! for the demo's report after a fresh clone, for `.ci/run`, which checks a change before it is
//! merged, and for the verdict of the queue's tests after a line of the queue was changed.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, bail};

use crate::cargo::cargo;
use crate::process::{capture, command_line};

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Wait {
    /// From a fresh clone to the demo's report.
    Demo,
    /// From a changed line in the queue to the verdict of the queue's tests.
    Line,
    /// `.ci/run` in a fresh clone: every check that a change must pass.
    Ci,
}

impl Wait {
    /// Returns the target in seconds, on two cores and with warm download caches.
    fn target(self) -> u64 {
        match self {
            Self::Demo => 6 * 60,
            Self::Line => 30,
            Self::Ci => 25 * 60,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Demo => "from a fresh clone to the demo's report",
            Self::Line => "from a changed line in the queue to the verdict of the queue's tests",
            Self::Ci => "`.ci/run` in a fresh clone",
        }
    }
}

/// Choice of the waits to time.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Waits to time, separated by commas.
    #[arg(long, value_delimiter = ',', default_value = "demo,line,ci")]
    only: Vec<Wait>,
}

/// Clones the committed state into this checkout's build folder, measures each wait in the clone,
/// and prints the wait and its target.
///
/// # Errors
/// If the clone cannot be made, or a timed command fails, which makes its time meaningless.
pub(crate) fn run(root: &Path, options: &Options) -> Result<()> {
    for &wait in &options.only {
        let clone = root.join("target/bench-build");
        if clone.exists() {
            fs::remove_dir_all(&clone).with_context(|| format!("remove {}", clone.display()))?;
        }
        let mut git = Command::new("git");
        capture(git.args(["clone", "--quiet"]).arg(root).arg(&clone))?;
        // Tests expect the reference data beside their checkout.
        let (shared, link) = (root.join("../shared"), root.join("target/shared"));
        if shared.exists() && !link.exists() {
            let shared = fs::canonicalize(&shared).context("find the reference data")?;
            std::os::unix::fs::symlink(shared, &link).context("link the reference data")?;
        }
        let seconds = match wait {
            Wait::Demo => timed(cargo(&clone).args(["xtask", "demo"]))?.0,
            Wait::Ci => {
                let mut check = Command::new("bash");
                let (seconds, output) = timed(check.arg(".ci/run").current_dir(&clone))?;
                let suites = output.lines().filter(|line| line.starts_with("Suite "));
                suites.for_each(|line| println!("  {line}"));
                seconds
            }
            Wait::Line => {
                queue_tests(&clone)?;
                let source = clone.join("crates/service/queue/src/lib.rs");
                let file = OpenOptions::new().append(true).open(&source);
                let mut file = file.with_context(|| format!("open {}", source.display()))?;
                writeln!(file, "// A new line makes cargo compile the crate again.")?;
                queue_tests(&clone)?
            }
        };
        let met = if seconds <= wait.target() { "met" } else { "missed" };
        println!("{}: {seconds} s, target {} s, {met}", wait.name(), wait.target());
    }
    Ok(())
}

/// Returns the seconds until the queue's tests passed.
fn queue_tests(clone: &Path) -> Result<u64> {
    let tests = ["nextest", "run", "--package", "queue"];
    Ok(timed(cargo(clone).args(tests))?.0)
}

/// Returns the seconds that a command took, and its standard output. If the command fails, the
/// error includes the ends of standard output and standard error.
fn timed(command: &mut Command) -> Result<(u64, String)> {
    // The variables set by the cargo that runs this program would affect the clone's build.
    for (name, _) in std::env::vars_os() {
        let text = name.to_string_lossy();
        if text.starts_with("CARGO_") && text != "CARGO_HOME" {
            command.env_remove(&name);
        }
    }
    let start = Instant::now();
    let output = command
        .stdin(Stdio::null())
        .output()
        .with_context(|| format!("start `{}`", command_line(command)))?;
    let seconds = start.elapsed().as_secs();
    if !output.status.success() {
        let tail = |bytes: &[u8]| {
            let text = String::from_utf8_lossy(bytes);
            let lines: Vec<&str> = text.lines().collect();
            lines[lines.len().saturating_sub(40)..].join("\n")
        };
        bail!(
            "time `{}`: {} after {seconds} s\n{}\n{}",
            command_line(command),
            output.status,
            tail(&output.stdout),
            tail(&output.stderr)
        );
    }
    Ok((seconds, String::from_utf8_lossy(&output.stdout).into_owned()))
}
