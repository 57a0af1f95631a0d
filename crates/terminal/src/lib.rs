//! Terminal conventions of all programs: log, output, manual pages, options from the environment,
//! and parsers of option values.

#![forbid(unsafe_code)]

use std::fs::{self, File};
use std::io;
use std::path::Path;

use clap_complete::Shell;
use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};

mod environment;
mod output;
mod printable;
mod values;

pub use environment::{cache_folder, parse, read, with_variables};
pub use output::{clear_lines, complain, counted, log, print, print_line, reader_is_gone, wrapped};
pub use printable::printable;
pub use values::{address, decimal, number, number_from, seconds};

/// Shells, with the folder of their completions, and prefix and suffix of a completion file's name.
const SHELLS: [(Shell, &str, &str, &str); 3] = [
    (Shell::Bash, "bash-completion/completions", "", ""),
    (Shell::Zsh, "zsh/site-functions", "_", ""),
    (Shell::Fish, "fish/vendor_completions.d", "", ".fish"),
];

/// Writes the manual pages of a program and its subcommands, such as
/// `coordinator-campaign-create.1`, and its completions in shells, into a prefix's folder `share`.
pub fn write_manual(program: clap::Command, share: &Path) -> io::Result<()> {
    let mut program = program.disable_help_subcommand(true);
    let name = program.get_name().to_owned();
    for (shell, folder, prefix, suffix) in SHELLS {
        let folder = share.join(folder);
        fs::create_dir_all(&folder)?;
        let mut file = File::create(folder.join(format!("{prefix}{name}{suffix}")))?;
        clap_complete::generate(shell, &mut program, &name, &mut file);
    }
    let pages = share.join("man/man1");
    fs::create_dir_all(&pages)?;
    clap_mangen::generate_to(program, pages)
}

/// Variable with the process id of the parent that this program must not outlive.
pub const PARENT_VARIABLE: &str = "ROLLOUT_PARENT";

/// Makes the kernel kill this process when its parent dies, if [`PARENT_VARIABLE`] names the
/// parent. Killing is safe, since every program may be killed at any time without losing confirmed
/// data; a parent that exits normally stops its children first.
pub fn end_with_parent() {
    let parent = std::env::var(PARENT_VARIABLE).ok();
    let parent = parent.and_then(|pid| Pid::from_raw(pid.parse().ok()?));
    // Descendants further down inherit the variable but have other parents.
    if parent.is_some() && parent == getppid() {
        // A failure only means that this process survives a killed parent.
        let _ = set_parent_process_death_signal(Some(Signal::KILL));
    }
}
