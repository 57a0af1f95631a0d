//! The `coordinator` program: reads the command line and calls the library.

#![forbid(unsafe_code)]

mod cli;

use std::ffi::OsString;
use std::process::ExitCode;

fn main() -> ExitCode {
    terminal::end_with_parent();
    let given: Vec<OsString> = std::env::args_os().collect();
    let is_gate = given.get(1).is_some_and(|command| command == "gate");
    match cli::Arguments::read(given) {
        Ok(arguments) => cli::run(arguments),
        // The usual code of a mistyped command is one of the gate's answers.
        Err(error) if is_gate && error.use_stderr() => {
            let _ = error.print();
            ExitCode::from(cli::NOT_COMPARABLE)
        }
        Err(error) => error.exit(),
    }
}
