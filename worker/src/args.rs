//! The command line of `worker`.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use protocol::{Level, Realisation, RolloutId, Suite};
use sim::GlDevice;

use crate::grpc::{EndpointError, parse_endpoint};

/// Simulates the rollouts of a coordinator's campaigns.
///
/// Ends when told to: one SIGTERM or Ctrl-C finishes the rollouts in hand, a
/// second one gives them back.
#[derive(Debug, Parser)]
#[command(
    version,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    override_usage = "worker --connect URL --assets PACK [OPTIONS]\n       \
                      worker rollout --id ID --endpoint URL --assets PACK --output DIR [OPTIONS]\n       \
                      worker preview --suite SUITE --task N --assets PACK --output DIR [OPTIONS]"
)]
pub struct Arguments {
    /// What else a worker can do.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// What a worker does as a rule: serves a coordinator,
    #[command(flatten)]
    pub serve: Option<ServeArguments>,
    /// with this simulator.
    #[command(flatten)]
    pub simulator: Option<SimulatorArguments>,
}

/// What else a worker can do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Simulates one rollout with a policy, without a coordinator, and writes
    /// what came of it to a folder
    Rollout(RolloutArguments),
    /// Shows what the perturbations of a configuration look like, without any
    /// policy
    Preview(PreviewArguments),
    /// The process of one slot, started by a worker
    #[command(hide = true)]
    Slot(SimulatorArguments),
}

/// How to serve a coordinator.
#[derive(Debug, Args)]
pub struct ServeArguments {
    /// URL of the coordinator
    #[arg(long, value_name = "URL", value_parser = server_url)]
    pub connect: String,
    /// Rollouts at a time, each in a process of its own
    #[arg(long, value_name = "N", default_value = "1")]
    pub slots: NonZeroUsize,
    /// Asks policies here instead of where the campaign says
    #[arg(long, value_name = "URL", value_parser = server_url)]
    pub policy_endpoint: Option<String>,
}

/// What simulates.
#[derive(Clone, Debug, Args)]
pub struct SimulatorArguments {
    /// Models of objects and rooms: `primitives`, or the path of a LIBERO
    /// assets folder
    #[arg(long, value_name = "PACK_OR_PATH")]
    pub assets: String,
    /// Robot models, task files and initial states, as `cargo xtask setup`
    /// unpacks them [default: rollout/sources in the user's cache folder]
    #[arg(long, value_name = "DIR", env = "ROLLOUT_SOURCES")]
    pub sources: Option<PathBuf>,
    /// Which of the graphics devices draws: `auto`, or its number
    #[arg(long, value_name = "DEVICE", default_value = "auto", value_parser = gl_device)]
    pub gl_device: GlDevice,
}

/// Which rollout, with which policy.
#[derive(Debug, Args)]
pub struct RolloutArguments {
    /// The rollout, for example spatial/t0/camera/L2/c00, or
    /// spatial/t0/clean/L0/c07
    #[arg(long, value_name = "ID")]
    pub id: RolloutId,
    /// URL of the policy, or of a gateway
    #[arg(long, value_name = "URL", value_parser = server_url)]
    pub endpoint: String,
    /// Which of the policies there; empty: the only one
    #[arg(long, value_name = "NAME", default_value = "")]
    pub policy: String,
    /// A folder for result.json, video.mp4 and frames/
    #[arg(long, value_name = "DIR")]
    pub output: PathBuf,
    /// Which repetition: it changes the policy's seed
    #[arg(long, value_name = "K", default_value = "0")]
    pub replicate: u32,
    /// Where random elements of perturbations come from: `matched` or
    /// `reference`
    #[arg(long, value_name = "MODE", default_value = "matched")]
    pub realisation: Realisation,
    /// Makes no video, which saves drawing two pictures per step
    #[arg(long)]
    pub no_video: bool,
    /// What simulates.
    #[command(flatten)]
    pub simulator: SimulatorArguments,
}

/// Which configuration, and how to show it.
#[derive(Debug, Args)]
pub struct PreviewArguments {
    /// The suite, for example libero_goal
    #[arg(long, value_name = "SUITE")]
    pub suite: Suite,
    /// The task in it, 0 to 9
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..10))]
    pub task: u32,
    /// The configuration: preset of every axis, and initial state
    #[arg(long, value_name = "N", default_value = "0", value_parser = clap::value_parser!(u16).range(0..10))]
    pub config: u16,
    /// Severity of the sheets that show all presets of an axis
    #[arg(long, value_name = "LEVEL", default_value = "L2")]
    pub level: Level,
    /// Where random elements of perturbations come from: `matched` or
    /// `reference`
    #[arg(long, value_name = "MODE", default_value = "matched")]
    pub realisation: Realisation,
    /// A folder for grid.png, presets_AXIS.png and actuation_paths.svg
    #[arg(long, value_name = "DIR")]
    pub output: PathBuf,
    /// What simulates.
    #[command(flatten)]
    pub simulator: SimulatorArguments,
}

fn server_url(text: &str) -> Result<String, EndpointError> {
    parse_endpoint(text).map(|_| text.to_owned())
}

fn gl_device(text: &str) -> Result<GlDevice, String> {
    match text.parse() {
        _ if text == "auto" => Ok(GlDevice::Auto),
        Ok(index) => Ok(GlDevice::Index(index)),
        Err(_) => Err("write `auto`, or a number such as 0".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    fn parse(line: &str) -> Result<Arguments, clap::Error> {
        Arguments::try_parse_from(line.split_whitespace())
    }

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn a_worker_needs_a_coordinator_and_assets() {
        let read = parse("worker --connect http://h:1 --assets primitives --slots 3");
        let read = read.expect("complete");
        assert_eq!(read.serve.expect("to serve").slots.get(), 3);
        let simulator = read.simulator.expect("a simulator");
        assert_eq!(simulator.gl_device, GlDevice::Auto);
        for line in ["worker --assets primitives", "worker --connect http://h:1"] {
            let error = parse(line).expect_err(line);
            assert_eq!(error.exit_code(), 2);
        }
    }

    #[test]
    fn one_rollout_needs_no_coordinator() {
        let line = "worker rollout --id spatial/t0/clean/L0/c07 --endpoint grpc://h:1 \
                    --assets primitives --output out --gl-device 1";
        let read = parse(line).expect("complete");
        let Some(Command::Rollout(rollout)) = read.command else {
            panic!("{read:?}")
        };
        assert_eq!(rollout.simulator.gl_device, GlDevice::Index(1));
        let error = parse(&line.replace("clean", "clear")).expect_err("no such condition");
        assert!(error.to_string().contains("camera"), "{error}");
    }

    #[test]
    fn what_cannot_be_meant_is_a_usage_error() {
        for line in [
            "worker --connect http://h:1 --assets primitives --slots 0",
            "worker --connect http://h:1 --assets primitives --gl-device gpu",
            "worker --connect localhost:7411 --assets primitives",
        ] {
            assert_eq!(parse(line).expect_err(line).exit_code(), 2);
        }
    }
}
