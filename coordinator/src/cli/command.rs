//! Helpers shared by all commands: coordinator client, error classes and output.

use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use coordinator::client::{Client, ClientError, RETRY_FOR};
use report::Subject;
use terminal::number;
use transport::{Access, AccessError, ClientArguments, Role};

/// The coordinator's address, and access to it.
#[derive(Args, Debug)]
#[command(next_help_heading = "Connection")]
pub(super) struct Connection {
    /// URL of the coordinator.
    #[arg(long, value_name = "URL", env = "COORDINATOR_URL")]
    #[arg(default_value = "http://127.0.0.1:7411")]
    connect: String,
    /// Seconds to keep trying while the coordinator does not answer.
    #[arg(long, value_name = "SECS", default_value_t = RETRY_FOR.as_secs(), hide_short_help = true,
        value_parser = number(0..=86_400_u64, "seconds"))]
    retry_secs: u64,
    #[command(flatten)]
    access: ClientArguments,
}

/// Error of a command; the variant determines the exit code.
pub(super) enum CommandError {
    /// The arguments are invalid; exit code 2.
    Usage(anyhow::Error),
    /// The command failed; exit code 1.
    Failure(anyhow::Error),
    /// The exit code is the command's answer, with an error to print if there is one.
    Answer(Option<anyhow::Error>, u8),
}

/// Prints a line to standard output.
pub(super) fn print_line(text: &str) -> anyhow::Result<()> {
    print(&format!("{text}\n"))
}

/// Prints text to standard output without a final newline.
pub(super) fn print(text: &str) -> anyhow::Result<()> {
    terminal::print(text).context("print to standard output")
}

/// Wraps the error of an invalid command.
pub(super) fn usage(error: impl Into<anyhow::Error>) -> CommandError {
    CommandError::Usage(error.into())
}

/// Wraps the error of a command that failed.
pub(super) fn failure(error: impl Into<anyhow::Error>) -> CommandError {
    CommandError::Failure(error.into())
}

impl Connection {
    /// Returns a client that retries for `--retry-secs`.
    pub(super) fn client(&self) -> Result<Client, CommandError> {
        self.client_retrying_for(Duration::from_secs(self.retry_secs))
    }

    /// Reads the results of each source: a file if it contains a `/`, which no campaign's name does,
    /// otherwise a campaign.
    pub(super) async fn subjects(&self, sources: &[String]) -> Result<Vec<Subject>, CommandError> {
        let mut subjects = Vec::new();
        for source in sources {
            subjects.push(match source.contains('/') {
                true => report::import(Path::new(source)).map_err(usage)?,
                false => self.client()?.report(source).await?,
            });
        }
        Ok(subjects)
    }

    /// Returns the credentials for a campaign's policy, from the same files as the coordinator's. A
    /// policy answers workers; an operator's token is never sent to it.
    pub(super) fn policy_access(&self) -> Result<Access, AccessError> {
        self.access.access(&[Role::Worker])
    }

    /// Returns a client that retries an unreachable coordinator for `retry_for`.
    pub(super) fn client_retrying_for(&self, retry_for: Duration) -> Result<Client, CommandError> {
        // The first role with a token counts; an operator may read everything that a viewer may.
        let access = self.access.access(&[Role::Operator, Role::Viewer]);
        let access = access.map_err(failure)?;
        Ok(Client::new(&self.connect, &access, retry_for)?)
    }
}

impl From<ClientError> for CommandError {
    fn from(error: ClientError) -> CommandError {
        match error {
            ClientError::Url(_) | ClientError::Access(_) | ClientError::Invalid { .. } => {
                usage(error)
            }
            ClientError::Unreachable { .. } | ClientError::Refused { .. } => failure(error),
        }
    }
}

impl From<anyhow::Error> for CommandError {
    fn from(error: anyhow::Error) -> CommandError {
        CommandError::Failure(error)
    }
}
