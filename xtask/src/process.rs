//! Runs external programs.

use std::process::Command;

use anyhow::{Context, Result, bail};

/// Formats a command as typed in a shell.
pub(crate) fn command_line(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
}

/// Runs a command with its output on this terminal. Fails if the command's exit status is not 0.
pub(crate) fn run(command: &mut Command) -> Result<()> {
    let status = command.status().with_context(|| format!("start `{}`", command_line(command)))?;
    if !status.success() {
        bail!("run `{}`: {status}", command_line(command));
    }
    Ok(())
}

/// Runs a command and returns its standard output. If the command fails, the error includes its
/// standard error.
pub(crate) fn capture(command: &mut Command) -> Result<String> {
    let output = command.output().with_context(|| format!("start `{}`", command_line(command)))?;
    if !output.status.success() {
        let stderr = String::from_utf8_lossy(&output.stderr);
        bail!("run `{}`: {}\n{}", command_line(command), output.status, stderr.trim_end());
    }
    Ok(String::from_utf8_lossy(&output.stdout).trim_end().to_owned())
}
