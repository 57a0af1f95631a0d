//! The command line of `coordinator`: parses the arguments and reports the outcome. The exit code
//! is 2 for an invalid command and 1 for a command that failed.

mod archives;
mod backup;
mod check;
mod command;
mod compare;
mod create;
mod explain;
mod export;
mod extend;
mod files;
mod forecast;
mod gate;
mod horizon;
mod interactions;
mod jobs;
mod json;
mod line;
mod manifest;
mod operate;
mod planning;
mod report;
mod search;
mod serve;
mod set;
mod slurm;
mod status;
mod thresholds;
mod up;
mod variant_flags;
mod watch;
mod workers;

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use proto::coordinator::change_campaign_request::Change;
use tokio::runtime::Runtime;

use command::CommandError;
pub(crate) use gate::NOT_COMPARABLE;

/// Creates campaigns, leases their rollouts to workers, stores the results and reports them.
#[derive(Debug, Parser)]
#[command(name = "coordinator", version = version::version!())]
pub(crate) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

impl Arguments {
    fn with_environment() -> clap::Command {
        Self::command().mut_subcommand("serve", terminal::with_variables)
    }

    /// Parses a command line, program name included, and the environment.
    pub(crate) fn read(words: Vec<OsString>) -> Result<Self, clap::Error> {
        let matches = terminal::parse(Self::with_environment(), words)?;
        let read = Self::from_arg_matches(&matches);
        read.map_err(|error| error.format(&mut Self::with_environment()))
    }
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run a coordinator, a gateway and a worker on this machine in one terminal.
    Up(up::UpArguments),
    /// Run a coordinator.
    Serve(serve::ServeArguments),
    /// Create, list and follow campaigns.
    #[command(subcommand)]
    Campaign(CampaignCommand),
    /// List the rollouts of a campaign, show one, or requeue or skip some.
    Jobs(jobs::JobsArguments),
    /// List the workers and their states.
    Workers(workers::WorkersArguments),
    /// Copy the database while the coordinator runs.
    Backup(backup::BackupArguments),
    /// Verify every invariant of a database, reading only.
    Check(check::CheckArguments),
    /// Check a manifest, compare two, or expand a design into one.
    Manifest(manifest::ManifestArguments),
    /// Report on campaigns, finished or not, or on result files.
    Report(report::ReportArguments),
    /// Compare two policies, given as campaigns or result files, over the rollouts that both have
    /// run.
    Compare(compare::CompareArguments),
    /// Decide whether a policy is worse than another, with as few rollouts as that takes.
    Gate(gate::GateArguments),
    /// Find the minimal subsets of the axes that cause emergent failures and compensated successes.
    Explain(explain::ExplainArguments),
    /// Measure the radius at which each configuration's success turns to failure, and the radius at
    /// which half of the configurations fail.
    Thresholds(thresholds::ThresholdsArguments),
    /// Report the effects of the axes alone and together in a campaign that ran every subset of
    /// them: success by subset, interactions, and each axis's share.
    Interactions(interactions::InteractionsArguments),
    /// Write the committed results of a campaign.
    Export(export::ExportArguments),
    /// Show, write or submit the scripts for a Slurm cluster: the coordinator on a permanent
    /// machine, workers as an array job, and a policy server behind the gateway.
    Slurm(Box<slurm::SlurmArguments>),
    /// Write this program's manual pages and shell completions.
    #[command(hide = true)]
    Manual {
        /// Folder `share` of a prefix.
        folder: PathBuf,
    },
}

#[derive(Debug, Subcommand)]
enum CampaignCommand {
    /// Create a campaign from a specification, or from flags.
    Create(Box<create::CreateArguments>),
    /// Add the rollouts that a campaign lacks of a larger design, or further rows.
    Extend(extend::ExtendArguments),
    /// List all campaigns, or show the progress of one.
    Status(status::StatusArguments),
    /// Stop leasing the campaign's rollouts; those in progress may still be committed.
    Pause(operate::ChangeArguments),
    /// Resume a paused campaign, or retry its paused policy at once.
    Resume(operate::ChangeArguments),
    /// End a campaign permanently; its results are kept.
    Cancel(operate::ChangeArguments),
    /// Change the priority, endpoint, policy or name of a campaign, or the endpoint of several.
    Set(set::SetArguments),
    /// Write a campaign with its results and files into one file.
    Archive(archives::ArchiveArguments),
    /// Verify an archive and add its campaign.
    Import(archives::ImportArguments),
    /// Remove a campaign with its results and files.
    Delete(operate::DeleteArguments),
}

/// Runs a command and prints its error, if any, to standard error.
pub(crate) fn run(arguments: Arguments) -> ExitCode {
    let default_level = match &arguments.command {
        Command::Serve(_) => "info",
        _ => "warn",
    };
    terminal::log(default_level);
    let runtime = Runtime::new().context("start the asynchronous runtime");
    let runtime = runtime.map_err(CommandError::Failure);
    let outcome = runtime.and_then(|runtime| runtime.block_on(execute(arguments.command)));
    let (error, code) = match outcome {
        Ok(()) => return ExitCode::SUCCESS,
        Err(CommandError::Usage(error)) => (error, 2),
        Err(CommandError::Failure(error)) => (error, 1),
        Err(CommandError::Answer(None, code)) => return ExitCode::from(code),
        Err(CommandError::Answer(Some(error), code)) => (error, code),
    };
    if terminal::reader_is_gone(&*error) {
        return ExitCode::SUCCESS;
    }
    terminal::complain(&format!("error: failed to {}", transport::chain(&*error)));
    ExitCode::from(code)
}

async fn execute(command: Command) -> Result<(), CommandError> {
    match command {
        Command::Up(arguments) => up::up(arguments).await,
        Command::Serve(arguments) => serve::serve(arguments).await,
        Command::Campaign(command) => campaign(command).await,
        Command::Jobs(arguments) => jobs::jobs(arguments).await,
        Command::Workers(arguments) => workers::workers(arguments).await,
        Command::Backup(arguments) => backup::backup(arguments).await,
        Command::Check(arguments) => check::check(arguments).await,
        Command::Manifest(arguments) => manifest::manifest(&arguments),
        Command::Report(arguments) => report::report(arguments).await,
        Command::Compare(arguments) => compare::compare(arguments).await,
        Command::Gate(arguments) => gate::gate(arguments).await,
        Command::Explain(arguments) => explain::explain(arguments).await,
        Command::Thresholds(arguments) => thresholds::thresholds(arguments).await,
        Command::Interactions(arguments) => interactions::interactions(arguments).await,
        Command::Export(arguments) => export::export(arguments).await,
        Command::Slurm(arguments) => slurm::slurm(&arguments),
        Command::Manual { folder } => {
            let written = terminal::write_manual(Arguments::with_environment(), &folder);
            Ok(written.with_context(|| format!("write into {}", folder.display()))?)
        }
    }
}

async fn campaign(command: CampaignCommand) -> Result<(), CommandError> {
    match command {
        CampaignCommand::Create(arguments) => create::create(*arguments).await,
        CampaignCommand::Extend(arguments) => extend::extend(arguments).await,
        CampaignCommand::Status(arguments) => status::status(arguments).await,
        CampaignCommand::Pause(arguments) => operate::change(arguments, Change::Pause).await,
        CampaignCommand::Resume(arguments) => operate::change(arguments, Change::Resume).await,
        CampaignCommand::Cancel(arguments) => operate::change(arguments, Change::Cancel).await,
        CampaignCommand::Set(arguments) => set::set(arguments).await,
        CampaignCommand::Archive(arguments) => archives::archive(arguments).await,
        CampaignCommand::Import(arguments) => archives::import(arguments).await,
        CampaignCommand::Delete(arguments) => operate::delete(arguments).await,
    }
}

#[cfg(test)]
#[path = "../../crates/terminal/tests/helps/mod.rs"]
mod helps;

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: `campaign create` printed 61 ungrouped lines for `-h` and `--help` alike.
    #[test]
    fn short_help_fits_a_screen_and_long_help_groups_connection_flags() {
        let helps = helps::check(Arguments::command());
        assert!(helps.len() > 20, "{}", helps.len());
        for helps::Help { words, short, long } in helps {
            if long.contains("--retry-secs") {
                assert!(long.contains("\nConnection:\n"), "{words}: {long}");
                assert!(!short.contains("--retry-secs"), "{words}: {short}");
            }
        }
    }
}
