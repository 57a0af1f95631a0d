//! `coordinator workers`.

use std::collections::BTreeMap;

use clap::Args;
use coordinator::client::{Client, Service};
use coordinator::words::{duration_text, runs_on};
use proto::coordinator::ListWorkersRequest;
use queue::clock::UnixMillis;
use queue::read::WorkerLine;
use terminal::counted;

use super::command::{CommandError, Connection, print_line};
use super::json;

#[derive(Args, Debug)]
pub(super) struct WorkersArguments {
    /// List departed workers, too.
    #[arg(long)]
    all: bool,
    /// Print JSON, as docs/JSON.md describes it.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn workers(arguments: WorkersArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let (now, workers) = list(&client).await?;
    let (alive, departed): (Vec<_>, Vec<_>) = workers.into_iter().partition(|line| line.is_alive);
    let hidden = if arguments.all { 0 } else { departed.len() };
    let shown = alive.into_iter().chain(departed.into_iter().filter(|_| arguments.all));
    if arguments.json {
        let shown = shown.map(|worker| WorkerLine { filming: None, ..worker });
        return json::print(&BTreeMap::from([("workers", shown.collect::<Vec<_>>())]));
    }
    let mut lines: Vec<String> = shown.map(|worker| describe_worker(&worker, now)).collect();
    if lines.is_empty() {
        lines.push("no worker is alive; start one with `worker --connect`".to_owned());
    }
    if hidden > 0 {
        lines.push(format!("{hidden} departed: --all shows them"));
    }
    Ok(print_line(&lines.join("\n"))?)
}

/// Returns the workers, and the coordinator's time.
async fn list(client: &Client) -> Result<(UnixMillis, Vec<WorkerLine>), CommandError> {
    Ok(client.ask_at(ListWorkersRequest {}, Service::list_workers).await?)
}

/// Counts finished rollouts whose videos live workers are still rendering or uploading.
pub(super) async fn filming(client: &Client) -> Result<u32, CommandError> {
    Ok(list(client).await?.1.iter().filter_map(|worker| worker.filming).sum())
}

/// Describes the number of rollouts being filmed in one line; `None` if it is zero.
pub(super) fn describe_filming(rollouts: u32) -> Option<String> {
    (rollouts > 0).then(|| {
        let rollouts = counted(rollouts.into(), "rollout");
        format!("slots are filming {rollouts} before they run further ones")
    })
}

fn describe_worker(worker: &WorkerLine, now: UnixMillis) -> String {
    let state = match (worker.is_alive, &worker.stopped_reason) {
        (false, _) if worker.has_signed_off => "ended".to_owned(),
        (false, _) => "gone".to_owned(),
        (true, None) => format!("{}/{} slots busy", worker.leases, worker.slots),
        (true, Some(reason)) => format!("gets no more leases: {reason}"),
    };
    let failures = match worker.failures_in_a_row {
        0 => String::new(),
        failures => format!(", {} in a row", counted(failures.into(), "failure")),
    };
    let filming = worker.filming.map_or_else(String::new, |rollouts| {
        format!("\n  filming {}", counted(rollouts.into(), "rollout"))
    });
    format!(
        "{} on {}: {state}{failures}, last call {} ago{filming}\n  {}",
        worker.worker_id,
        worker.host,
        duration_text(now.since(worker.last_call_at).as_secs_f64()),
        runs_on(
            &worker.asset_pack,
            &worker.mujoco_version,
            &worker.renderer,
            &worker.look,
            &worker.program_version
        )
    )
}
