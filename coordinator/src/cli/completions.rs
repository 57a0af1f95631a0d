//! `coordinator completions`.

use benchmark::{Axis, Suite};
use clap::{Args, Command};
use clap_complete::Shell;

use super::command::{CommandError, print};

/// Completion of names that the command line does not define.
const NAMES: &str = include_str!("completions.bash");

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
    let mut script = String::from_utf8_lossy(&script).into_owned();
    if arguments.shell == Shell::Bash {
        let axes: Vec<&str> = Axis::every().map(Axis::name).collect();
        let axes = axes.join(" ") + " metric all none";
        let suites = Suite::ALL.map(Suite::name).join(" ") + " all";
        let names = [("AXES", axes.as_str()), ("LEVELS", "L0 L1 L2 L3"), ("SUITES", &suites)];
        let mut of_names = NAMES.to_owned();
        for (place, names) in names {
            of_names = of_names.replace(&format!("\"{place}\""), &format!("\"{names}\""));
        }
        script.push_str(&of_names);
    }
    Ok(print(&script)?)
}
