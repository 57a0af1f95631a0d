//! `coordinator check`.

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use queue::invariants::{CheckError, INVARIANTS, check as check_database};

use super::command::{CommandError, failure, print_line, usage};

#[derive(Args, Debug)]
pub(super) struct CheckArguments {
    /// A data folder, or a database file such as a backup.
    #[arg(value_name = "DATA_DIR_OR_DB")]
    path: PathBuf,
}

pub(super) async fn check(arguments: CheckArguments) -> Result<(), CommandError> {
    let violations = check_database(&arguments.path).await;
    let violations = violations.map_err(|error| match error {
        CheckError::Missing { .. } => usage(error),
        error => failure(error),
    })?;
    for violation in &violations {
        print_line(&format!("{}: {}", violation.invariant, violation.count))?;
        for example in &violation.examples {
            print_line(&format!("  {example}"))?;
        }
        if violation.count > violation.examples.len() {
            print_line("  …")?;
        }
    }
    let total = INVARIANTS.len();
    if violations.is_empty() {
        return Ok(print_line(&format!("all {total} invariants hold"))?);
    }
    let error = anyhow!("{} of {total} invariants are violated", violations.len());
    let database = arguments.path.display();
    Err(failure(error.context(format!("verify {database}"))))
}
