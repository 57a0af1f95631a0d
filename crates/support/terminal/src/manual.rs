//! Manual pages, generated from a program's command line definition.

use std::io;
use std::path::Path;

/// Writes the manual pages of a program and its subcommands, such as
/// `coordinator-campaign-create.1`, into a folder, which is created if necessary.
pub fn write_manual(program: clap::Command, folder: &Path) -> io::Result<()> {
    std::fs::create_dir_all(folder)?;
    // The `help` subcommand needs no page.
    clap_mangen::generate_to(program.disable_help_subcommand(true), folder)
}
