//! `coordinator launch`: scripts with which a cluster's scheduler runs workers and a policy server
//! for a coordinator, filled in from the templates in `deploy/`.

mod checked;
mod scripts;
mod slurm;
mod template;
mod time_limit;

use clap::Subcommand;

use super::command::CommandError;

#[derive(Debug, Subcommand)]
pub(super) enum LaunchCommand {
    /// Show, write or submit the scripts for a Slurm cluster: the coordinator on a permanent
    /// machine, workers as an array job, and a policy server behind the gateway.
    Slurm(Box<slurm::SlurmArguments>),
}

pub(super) fn launch(command: LaunchCommand) -> Result<(), CommandError> {
    match command {
        LaunchCommand::Slurm(arguments) => slurm::slurm(&arguments),
    }
}
