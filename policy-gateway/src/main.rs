//! The gateway's command line: reads it, binds the port, and leaves the rest to
//! the library.

#![forbid(unsafe_code)]

use std::{
    io::{Write, stdout},
    net::SocketAddr,
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::Context;
use clap::{Args, CommandFactory, Parser, Subcommand, error::ErrorKind};
use policy_gateway::{
    config::{self, Config, RouteSpec},
    conformance::{self, Target},
    service::Gateway,
};
use tokio::{
    net::TcpListener,
    signal::unix::{Signal, SignalKind, signal},
    task::JoinSet,
};
use tracing_subscriber::EnvFilter;
use transport::{ClientArguments, Role, Security, SecurityError, ServerArguments};

/// Serves policies to workers: each route is a name and what answers for it.
#[derive(Debug, Parser)]
#[command(
    version,
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
struct Serve {
    /// Where to listen; port 0 takes a free one, and the line printed names it
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:7071")]
    listen: SocketAddr,

    /// A policy's name and what answers for it: grpc://HOST:PORT[/POLICY],
    /// builtin:noop or builtin:expert, or several replicas with commas between
    /// (repeatable)
    #[arg(
        long = "route",
        value_name = "NAME=BACKEND",
        required_unless_present = "config",
        conflicts_with = "config"
    )]
    routes: Vec<RouteSpec>,

    /// A file of policies, their replicas and checkpoints per suite; SIGHUP
    /// reads it again
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    #[command(flatten)]
    security: ServerArguments,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Checks whether a policy server keeps the policy protocol, point by point
    Check {
        /// Where it listens
        #[arg(value_name = "grpc://HOST:PORT")]
        url: String,

        /// Which policy there, if it serves several
        #[arg(long, value_name = "NAME", default_value = "")]
        policy: String,

        #[command(flatten)]
        access: ClientArguments,
    },
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .init();
    let done = match arguments.command {
        Some(Command::Check {
            url,
            policy,
            access,
        }) => check(url, policy, &access),
        None => {
            let Serve {
                listen,
                routes,
                config: file,
                security,
            } = arguments.serve;
            let security = security.security(listen);
            let unguarded = matches!(security, Err(SecurityError::Unguarded { .. }));
            let security = match security {
                Err(error) if unguarded => usage_error(&error),
                security => security,
            };
            let config = match &file {
                Some(file) => config::file::read(file).map_err(anyhow::Error::from),
                None => Ok(Config::new(routes).unwrap_or_else(|error| usage_error(&error))),
            };
            security
                .map_err(anyhow::Error::from)
                .and_then(|security| serve(listen, &config?, file, &security))
                .map(|()| ExitCode::SUCCESS)
        }
    };
    done.unwrap_or_else(|error| {
        eprintln!("policy-gateway: failed to {error:#}");
        ExitCode::FAILURE
    })
}

/// Ends the program: what was typed cannot be meant.
fn usage_error(error: &dyn std::error::Error) -> ! {
    let text = format!("failed to {error}");
    Arguments::command()
        .error(ErrorKind::ValueValidation, text)
        .exit()
}

/// Prints a verdict per point; fails if one of them did.
#[tokio::main]
async fn check(url: String, policy: String, access: &ClientArguments) -> anyhow::Result<ExitCode> {
    let target = Target {
        url,
        policy,
        access: access.access(&[Role::Operator, Role::Worker])?,
    };
    let conforms = conformance::check(&target, &mut |finding| println!("{finding}")).await?;
    println!(
        "{}",
        if conforms {
            "conforms"
        } else {
            "does not conform"
        }
    );
    Ok(if conforms {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

#[tokio::main]
async fn serve(
    listen: SocketAddr,
    config: &Config,
    file: Option<PathBuf>,
    security: &Security,
) -> anyhow::Result<()> {
    let gateway = Gateway::new(config)?;
    // Ends with this function.
    let mut reloading = JoinSet::new();
    if let Some(file) = file {
        let hangups = signal(SignalKind::hangup()).context("listen for SIGHUP")?;
        reloading.spawn(reload(gateway.clone(), file, hangups));
    }
    let mut terminate = signal(SignalKind::terminate()).context("listen for SIGTERM")?;
    let mut interrupt = signal(SignalKind::interrupt()).context("listen for SIGINT")?;
    let listener = TcpListener::bind(listen)
        .await
        .with_context(|| format!("listen on {listen}: choose another --listen address"))?;
    let address = listener
        .local_addr()
        .context("read the address listened on")?;
    let over = if security.is_encrypted() {
        " over TLS"
    } else {
        ""
    };
    writeln!(stdout(), "listening on {address}{over}").context("print the address listened on")?;

    let shutdown = async move {
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
        tracing::info!("stopping: letting the queries under way finish");
    };
    Ok(policy_gateway::run(gateway, security, listener, shutdown).await?)
}

/// Reads the configuration again at every hang-up. One that cannot be used
/// changes nothing.
async fn reload(gateway: Gateway, file: PathBuf, mut hangups: Signal) {
    let read_again = |file: &Path| -> anyhow::Result<usize> {
        let config = config::file::read(file)?;
        gateway.reload(&config)?;
        Ok(config.routes().len())
    };
    while hangups.recv().await.is_some() {
        match read_again(&file) {
            Ok(policies) => tracing::info!(policies, "read {} again", file.display()),
            Err(error) => tracing::error!("going on as before: failed to {error:#}"),
        }
    }
}
