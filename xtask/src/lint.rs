//! Lints and types of the Python sources. The rules are in `ruff.toml` and `mypy.ini`.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::process::command_line;
use crate::step::step;
use crate::venv::environment;

/// The tools, and the packages whose annotations mypy reads.
const PACKAGES: [&str; 4] = ["gymnasium==1.4.0", "mypy==2.4.1", "numpy==2.4.6", "ruff==0.17.6"];

/// Lints the Python sources and checks their types; prints a message if the tools cannot be
/// installed.
pub(crate) fn run(root: &Path, cache: &Path) -> Result<()> {
    let dir = cache.join("lint-venv");
    let outcome = environment(&dir, &PACKAGES);
    if let Err(error) = outcome {
        return step("Python", || Ok(format!("not checked: {error:#}"))).map(drop);
    }
    for (title, tool, arguments) in [
        ("Python lints", "ruff", &["check", "--output-format=concise", "."][..]),
        ("Python types", "mypy", &[]),
    ] {
        let mut command = Command::new(dir.join("bin").join(tool));
        command.current_dir(root).args(arguments);
        step(title, || run_tool(&mut command))?;
    }
    Ok(())
}

/// Runs a tool; if it reports faults, the error includes its output.
fn run_tool(command: &mut Command) -> Result<&'static str> {
    let output = command.output().with_context(|| format!("start `{}`", command_line(command)))?;
    if output.status.success() {
        return Ok("in order");
    }
    let printed = [output.stdout, output.stderr].concat();
    let printed = String::from_utf8_lossy(&printed);
    bail!("run `{}`:\n{}", command_line(command), printed.trim_end());
}
