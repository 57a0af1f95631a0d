//! `coordinator launch`: what a cluster's scheduler needs to run workers, and a policy
//! server, for a coordinator. The scripts are `deploy`'s, with what was asked for
//! filled in.

mod checked;
mod scripts;
mod slurm;
mod template;
mod time_limit;

use clap::Subcommand;

use super::command::CommandError;

#[derive(Debug, Subcommand)]
pub(super) enum LaunchCommand {
    /// Show, write or submit the scripts for a cluster that Slurm schedules: the
    /// coordinator on a machine that stays, workers as an array job, a policy
    /// server with the gateway before it.
    Slurm(Box<slurm::SlurmArguments>),
}

pub(super) fn launch(command: LaunchCommand) -> Result<(), CommandError> {
    match command {
        LaunchCommand::Slurm(arguments) => slurm::slurm(&arguments),
    }
}
