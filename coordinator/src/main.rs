//! The `coordinator` program: reads the command line and calls the library.

#![forbid(unsafe_code)]

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    terminal::end_with_parent();
    let arguments = cli::Arguments::read(std::env::args_os().collect());
    cli::run(arguments.unwrap_or_else(|error| error.exit()))
}
