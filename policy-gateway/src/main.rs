//! Command line of the gateway: parses it, binds the port, and calls the library.

#![forbid(unsafe_code)]

use std::env::args_os;
use std::io::{Write, stdout};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::process::ExitCode;

use anyhow::Context;
use clap::error::ErrorKind;
use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use policy_backends::recorder::{DEFAULT_MAX_BYTES, RecordInto};
use policy_backends::{BackendSpec, spec};
use policy_gateway::config::{self, Config, RouteName, RouteSpec};
use policy_gateway::service::Gateway;
use terminal::{number, reader_is_gone};
use tokio::net::TcpListener;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::task::JoinSet;
use transport::{Security, SecurityError, ServerArguments};

use crate::examine::{Check, Compare};

mod examine;

/// Serves policies to workers: each route maps a policy's name to its back-end.
#[derive(Debug, Parser)]
#[command(
    version = version::version!(),
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true
)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,

    #[command(flatten)]
    serve: Serve,
}

#[derive(Debug, Args)]
struct Listen {
    /// Listening address; port 0 selects a free port, which is printed at the start
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:7412",
        value_parser = terminal::address)]
    listen: SocketAddr,

    #[command(flatten)]
    security: ServerArguments,
}

#[derive(Debug, Args)]
struct Serve {
    #[arg(
        long = "route",
        help = format!("A policy's name and its back-end (repeatable): {}; or several replicas, \
            separated by commas", spec::forms()),
        value_name = "NAME=BACKEND",
        required_unless_present = "config",
        conflicts_with = "config"
    )]
    routes: Vec<RouteSpec>,

    /// Configuration file with policies, their replicas and checkpoints per suite;
    /// SIGHUP reloads it
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    #[command(flatten)]
    listen: Listen,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Checks whether a policy server conforms to the policy protocol, point by point, and
    /// looks for mistakes that make all rollouts fail
    Check(Box<Check>),
    /// Sends two policy servers the same observations, and explains how their
    /// answers differ
    Compare(Box<Compare>),
    /// Forwards queries to a policy server and records its sessions (observations
    /// and actions), one file each, until it is stopped
    Record {
        /// The server, as in --route
        #[arg(long, value_name = "BACKEND")]
        upstream: BackendSpec,

        /// Folder for the recordings; created if missing
        #[arg(long, value_name = "DIR")]
        output: PathBuf,

        /// Name under which the policy is served
        #[arg(long, value_name = "NAME", default_value = "policy")]
        policy: RouteName,

        /// Largest total size of the recordings, MiB
        #[arg(long, value_name = "N", default_value_t = DEFAULT_MAX_BYTES >> 20,
            value_parser = number(1..=1_u64 << 40, "MiB"))]
        max_mib: u64,

        #[command(flatten)]
        listen: Listen,
    },
    /// Prints a script that completes this program's commands in a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
    /// Writes this program's manual pages
    #[command(hide = true)]
    Manual {
        /// Folder for the pages
        folder: PathBuf,
    },
}

fn main() -> ExitCode {
    terminal::end_with_parent();
    let matches = terminal::read(Arguments::command(), args_os().collect());
    let arguments = matches.and_then(|matches| {
        let read = Arguments::from_arg_matches(&matches);
        read.map_err(|error| error.format(&mut Arguments::command()))
    });
    let arguments = arguments.unwrap_or_else(|error| error.exit());
    terminal::log("info");
    let done = match arguments.command {
        Some(Command::Check(check)) => check.run(),
        Some(Command::Compare(compare)) => compare.run(),
        Some(Command::Record { upstream, output, policy, max_mib, listen }) => {
            let into = RecordInto { max_bytes: max_mib << 20, folder: output };
            record(RouteSpec::new(policy, vec![upstream]), into, &listen)
        }
        Some(Command::Completions { shell }) => print_completions(shell),
        Some(Command::Manual { folder }) => manual(&folder),
        None => {
            let Serve { routes, config: file, listen } = arguments.serve;
            match file {
                None => serve_routes(routes, &listen),
                Some(file) => config::read(&file)
                    .map_err(anyhow::Error::from)
                    .and_then(|config| listen.serve(&config, Some(file))),
            }
        }
    };
    done.unwrap_or_else(|error| {
        terminal::complain(&format!("policy-gateway: failed to {}", transport::chain(&*error)));
        ExitCode::FAILURE
    })
}

fn print_completions(shell: clap_complete::Shell) -> anyhow::Result<ExitCode> {
    let mut script = Vec::new();
    let mut command = Arguments::command();
    clap_complete::generate(shell, &mut command, "policy-gateway", &mut script);
    let written = stdout().write_all(&script);
    written.context("print to standard output")?;
    Ok(ExitCode::SUCCESS)
}

fn manual(folder: &Path) -> anyhow::Result<ExitCode> {
    let written = terminal::write_manual(terminal::with_variables(Arguments::command()), folder);
    written.with_context(|| format!("write manual pages into {}", folder.display()))?;
    Ok(ExitCode::SUCCESS)
}

impl Listen {
    /// Serves until a signal to stop.
    fn serve(&self, config: &Config, file: Option<PathBuf>) -> anyhow::Result<ExitCode> {
        let security = match self.security.security(self.listen) {
            Err(error @ SecurityError::Unguarded { .. }) => usage_error(&error),
            security => security?,
        };
        serve(self.listen, config, file, &security)?;
        Ok(ExitCode::SUCCESS)
    }
}

fn serve_routes(routes: Vec<RouteSpec>, listen: &Listen) -> anyhow::Result<ExitCode> {
    let config = Config::new(routes).unwrap_or_else(|error| usage_error(&error));
    listen.serve(&config, None)
}

fn record(route: RouteSpec, into: RecordInto, listen: &Listen) -> anyhow::Result<ExitCode> {
    let folder = &into.folder;
    std::fs::create_dir_all(folder).with_context(|| {
        format!("make the folder {folder:?}: give --output one that this user may write to")
    })?;
    let record = Some(into);
    serve_routes(vec![RouteSpec { record, ..route }], listen)
}

/// Ends the program with a usage error.
fn usage_error(error: &dyn std::error::Error) -> ! {
    let text = format!("failed to {error}");
    Arguments::command().error(ErrorKind::ValueValidation, text).exit()
}

#[tokio::main]
async fn serve(
    listen: SocketAddr,
    config: &Config,
    file: Option<PathBuf>,
    security: &Security,
) -> anyhow::Result<()> {
    let gateway = Gateway::new(config)?;
    // The task ends when this function returns and drops the set.
    let mut reloading = JoinSet::new();
    if let Some(file) = file {
        let hangups = signal(SignalKind::hangup()).context("listen for SIGHUP")?;
        reloading.spawn(reload(gateway.clone(), file, hangups));
    }
    let mut terminate = signal(SignalKind::terminate()).context("listen for SIGTERM")?;
    let mut interrupt = signal(SignalKind::interrupt()).context("listen for SIGINT")?;
    transport::raise_file_limit();
    let listener = TcpListener::bind(listen)
        .await
        .with_context(|| format!("listen on {listen}: choose another --listen address"))?;
    let address = listener.local_addr().context("read the address listened on")?;
    let tls_note = if security.is_encrypted() { " over TLS" } else { "" };
    match terminal::print_line(&format!("listening on {address}{tls_note}")) {
        // Standard output may be a closed pipe.
        Err(error) if !reader_is_gone(&error) => {
            return Err(error).context("print the address listened on");
        }
        _ => {}
    }

    let shutdown = async move {
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
        tracing::info!("stopping: letting the queries under way finish");
    };
    let mut served = pin!(policy_gateway::run(gateway, security, listener, shutdown));
    tokio::select! {
        served = &mut served => return Ok(served?),
        // Without a task that reloads the configuration, this branch is disabled.
        Some(ended) = reloading.join_next() => tracing::error!(
            "SIGHUP no longer reads the configuration again, because {}; restart the gateway when \
             no rollout is under way",
            ended.map_or_else(|error| error.to_string(), |()| "no more signals arrive".to_owned())
        ),
    }
    Ok(served.await?)
}

/// Reloads the configuration at every SIGHUP. An invalid configuration is logged and ignored.
async fn reload(gateway: Gateway, file: PathBuf, mut hangups: Signal) {
    let read_again = |file: &Path| -> anyhow::Result<usize> {
        let config = config::read(file)?;
        gateway.reload(&config)?;
        Ok(config.routes().len())
    };
    while hangups.recv().await.is_some() {
        match read_again(&file) {
            Ok(policies) => tracing::info!(policies, "read {} again", file.display()),
            Err(error) => tracing::error!(
                "continuing with the earlier configuration: failed to {}",
                transport::chain(&*error)
            ),
        }
    }
}

#[cfg(test)]
#[path = "../../crates/terminal/tests/helps/mod.rs"]
mod helps;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_help_fits_a_screen() {
        let helps = helps::check(Arguments::command());
        let check = helps.iter().find(|help| help.words == "policy-gateway check");
        let check = check.expect("a command");
        assert!(check.short.len() < check.long.len(), "{}", check.short);
    }
}
