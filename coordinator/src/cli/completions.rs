//! `coordinator completions`.

use clap::{Args, Command};
use clap_complete::Shell;

use super::command::{CommandError, print};

#[derive(Args, Debug)]
pub(super) struct CompletionsArguments {
    /// Shell for which the script is printed.
    shell: Shell,
}

/// Prints the shell completion script of `command`, the whole command line of this program.
pub(super) fn completions(
    arguments: CompletionsArguments,
    mut command: Command,
) -> Result<(), CommandError> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut command, "coordinator", &mut script);
    Ok(print(&String::from_utf8_lossy(&script))?)
}
