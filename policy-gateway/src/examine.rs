//! `policy-gateway check` and `policy-gateway compare`. A server of another protocol, or a built-in
//! policy, is examined behind a gateway in this process, as workers see it.

use std::fmt::Display;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use benchmark::Suite;
use clap::Args;
use policy_backends::BackendSpec;
use policy_backends::grpc::GrpcAddress;
use policy_gateway::config::{AccessFiles, Config, RouteSpec};
use policy_gateway::doctor::latency::measure;
use policy_gateway::doctor::probe::{ExaminationError, Probe, Target};
use policy_gateway::doctor::report::{self, CheckJson, ComparisonJson, DescribedServer};
use policy_gateway::doctor::verdict::Finding;
use policy_gateway::doctor::{check, compare};
use policy_gateway::service::Gateway;
use serde::Serialize;
use tokio::net::TcpListener;
use tokio::task::JoinSet;
use transport::{ClientArguments, Role, Security};

/// Inputs of a server, each of which may have another key.
const INPUTS: usize = 4;

#[derive(Clone, Debug, Args)]
struct Options {
    /// Suite of the tasks in the queries
    #[arg(long, value_name = "SUITE", default_value_t = Suite::Object)]
    suite: Suite,

    /// Print JSON
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    access: ClientArguments,
}

#[derive(Clone, Debug, Args)]
pub(crate) struct Check {
    /// The server, as in --route, without NAME=
    #[arg(value_name = "URL")]
    url: BackendSpec,

    /// Also measures the server's latency under load, and writes the distribution
    /// of delays for `coordinator campaign create --execution overlap:@FILE`
    #[arg(long, value_name = "FILE")]
    latency: Option<PathBuf>,

    #[command(flatten)]
    options: Options,
}

#[derive(Clone, Debug, Args)]
pub(crate) struct Compare {
    /// One server, as in --route, without NAME=
    #[arg(value_name = "URL-A")]
    a: BackendSpec,

    /// The other server
    #[arg(value_name = "URL-B")]
    b: BackendSpec,

    #[command(flatten)]
    options: Options,
}

/// A server to examine. Dropping this value stops the gateway in front of it, if there is one.
struct Reached {
    target: Target,
    _gateway: JoinSet<()>,
}

async fn reach(spec: &BackendSpec, options: &Options) -> anyhow::Result<Reached> {
    let access = options.access.access(&[Role::Operator, Role::Worker])?;
    let mut gateway = JoinSet::new();
    let shown = spec.to_string();
    let (url, policy) = match shown.parse() {
        Ok(GrpcAddress { authority, policy, encrypted }) => {
            let scheme = if encrypted { "https" } else { "grpc" };
            (format!("{scheme}://{authority}"), policy)
        }
        Err(_) => {
            let ClientArguments { ca, token_file } = options.access.clone();
            let access = AccessFiles { ca, token_file };
            let route =
                RouteSpec { access, ..RouteSpec::new("policy".parse()?, vec![spec.clone()]) };
            let served = Gateway::new(&Config::new(vec![route])?)?;
            let listener = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], 0))).await;
            let listener = listener.context("open a port of 127.0.0.1 for this command")?;
            let url = format!("grpc://{}", listener.local_addr()?);
            gateway.spawn(async move {
                let (security, until_dropped) = (Security::loopback(), std::future::pending());
                if let Err(error) =
                    policy_gateway::run(served, &security, listener, until_dropped).await
                {
                    tracing::error!("the gateway in front of the server failed to {error}");
                }
            });
            (url, String::new())
        }
    };
    let target = Target { url, shown, policy, suite: options.suite, access };
    Ok(Reached { target, _gateway: gateway })
}

impl Check {
    /// Prints a verdict per point. The exit code is 1 if the server does not conform.
    #[tokio::main]
    pub(crate) async fn run(self) -> anyhow::Result<ExitCode> {
        let print = |line: &dyn Display| {
            if !self.options.json {
                print_line(line);
            }
        };
        let mut spec = self.url.clone();
        let mut findings = vec![];
        let mut keys_left = INPUTS;
        let (conforms, reached) = loop {
            let reached = reach(&spec, &self.options).await?;
            let mut report = |finding: &Finding| {
                print(&report::finding(finding));
                findings.push(finding.clone());
            };
            let checked = check::check(&reached.target, &mut report).await;
            // The server's error names the key that it misses.
            let corrected = match &checked {
                Err(ExaminationError::Episode { status, .. }) if keys_left > 0 => {
                    spec.corrected(status.message())
                }
                _ => None,
            };
            match corrected {
                Some(corrected) => {
                    keys_left -= 1;
                    spec = corrected;
                }
                None => break (checked?, reached),
            }
        };
        let url = spec.to_string();
        if spec != self.url {
            print(&format!("its inputs have other keys: write {url} as its route"));
        }
        print(&match (conforms, findings.iter().any(Finding::is_warning)) {
            (false, _) => "does not conform",
            (true, true) => "conforms; see the warnings if no rollout succeeds",
            (true, false) => "conforms",
        });
        if self.options.json {
            print_json(&CheckJson::new(&url, &findings));
        }
        if let Some(file) = self.latency {
            let measured = measure(&reached.target).await?;
            print(&measured.describe());
            let delays = measured.delays()?;
            let text = serde_json::to_string_pretty(&measured)?;
            let shown = file.display();
            std::fs::write(&file, text + "\n").with_context(|| format!("write {shown}"))?;
            print(&format!(
                "`coordinator campaign create --execution overlap:@{shown}` draws delays from this \
                 distribution: overlap:{delays}"
            ));
        }
        Ok(exit_code(conforms))
    }
}

impl Compare {
    /// The exit code is 0 if the servers answer alike, else 1.
    #[tokio::main]
    pub(crate) async fn run(self) -> anyhow::Result<ExitCode> {
        let (a, b) = (reach(&self.a, &self.options).await?, reach(&self.b, &self.options).await?);
        let (probe_a, probe_b) =
            (Probe::connect(&a.target).await?, Probe::connect(&b.target).await?);
        let described = [(&a, &probe_a), (&b, &probe_b)]
            .map(|(server, probe)| DescribedServer::new(&server.target.shown, &probe.described));
        if !self.options.json {
            for (letter, server) in ["A", "B"].iter().zip(&described) {
                print_line(&server.line(letter));
            }
        }
        let comparison = compare::compare(probe_a, probe_b).await?;
        if self.options.json {
            let [a, b] = described;
            print_json(&ComparisonJson::new(a, b, &comparison));
        } else {
            for line in report::comparison(&comparison) {
                print_line(&line);
            }
        }
        Ok(exit_code(comparison.differences.is_empty()))
    }
}

fn exit_code(is_good: bool) -> ExitCode {
    if is_good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn print_json(value: &impl Serialize) {
    print_line(&serde_json::to_string_pretty(value).expect("numbers and text are JSON"));
}

/// Prints a line, without control sequences, because parts of the line come from servers. Ignores
/// a closed pipe (`| head`), because the exit code still reports the outcome.
fn print_line(line: &dyn Display) {
    drop(terminal::print_line(&line.to_string()));
}
