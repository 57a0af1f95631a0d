//! Manual pages, from what a program's own command line says.

use std::io;
use std::path::Path;

/// Writes a page of a program and one of each of its commands, such as
/// `coordinator-campaign-create.1`, into a folder, which is made if need be.
///
/// # Errors
/// If they cannot be written.
pub fn write_manual(program: clap::Command, folder: &Path) -> io::Result<()> {
    std::fs::create_dir_all(folder)?;
    // `help` is a command too, and its page would tell nobody anything.
    clap_mangen::generate_to(program.disable_help_subcommand(true), folder)
}
