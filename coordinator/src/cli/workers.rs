//! `coordinator workers`.

use std::time::Duration;

use clap::Args;
use coordinator::client::{Client, Service};
use coordinator::words::{duration_text, runs_on};
use proto::coordinator::{ListWorkersRequest, WorkerStatus};
use terminal::counted;

use super::command::{CommandError, Connection, print_line};
use super::json;

/// Time for which `--all` lists a worker after its last call.
const LISTED_AFTER_DEPARTURE: Duration = Duration::from_secs(7 * 86_400);

#[derive(Args, Debug)]
pub(super) struct WorkersArguments {
    /// List departed workers, too; without --json, only those whose last call was within a week.
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
    let listed = client.call(ListWorkersRequest {}, Service::list_workers);
    let workers = listed.await?.workers.into_iter();
    let (alive, departed): (Vec<_>, Vec<_>) = workers.partition(|worker| worker.alive);
    if arguments.json {
        let shown = alive.iter().chain(departed.iter().filter(|_| arguments.all));
        return json::print(&json::Workers::from_messages(shown));
    }
    let (recent, older): (Vec<_>, Vec<_>) = departed
        .iter()
        .partition(|worker| worker.silent_secs < LISTED_AFTER_DEPARTURE.as_secs_f64());
    let shown = alive.iter().chain(recent.iter().copied().filter(|_| arguments.all));
    let mut lines: Vec<String> = shown.map(describe_worker).collect();
    if lines.is_empty() {
        lines.push("no worker is alive; start one with `worker --connect`".to_owned());
    }
    if !arguments.all && !recent.is_empty() {
        lines.push(format!("{} departed: --all shows them", recent.len()));
    }
    if arguments.all && !older.is_empty() {
        lines.push(format!(
            "{} without a call for a week or more: --all --json lists them too",
            counted(older.len() as u64, "worker")
        ));
    }
    Ok(print_line(&lines.join("\n"))?)
}

/// Counts finished rollouts whose videos live workers are still rendering or uploading.
pub(super) async fn filming(client: &Client) -> Result<u32, CommandError> {
    let listed = client.call(ListWorkersRequest {}, Service::list_workers);
    let workers = listed.await?.workers;
    let alive = workers.iter().filter(|worker| worker.alive);
    Ok(alive.map(|worker| worker.filming).sum())
}

/// Describes the number of rollouts being filmed in one line; `None` if it is zero.
pub(super) fn describe_filming(rollouts: u32) -> Option<String> {
    (rollouts > 0).then(|| {
        let rollouts = counted(rollouts.into(), "rollout");
        format!("slots are filming {rollouts} before they run further ones")
    })
}

fn describe_worker(worker: &WorkerStatus) -> String {
    let state = match (worker.alive, worker.stopped_reason.as_str()) {
        (false, _) if worker.signed_off => "ended".to_owned(),
        (false, _) => "gone".to_owned(),
        (true, "") => format!("{}/{} slots busy", worker.leases, worker.slots),
        (true, reason) => format!("gets no more leases: {reason}"),
    };
    let failures = match worker.charged_in_a_row {
        0 => String::new(),
        failures => format!(", {} in a row", counted(failures.into(), "failure")),
    };
    let filming = match worker.filming {
        0 => String::new(),
        1 => "\n  filming 1 rollout".to_owned(),
        rollouts => format!("\n  filming {rollouts} rollouts"),
    };
    format!(
        "{} on {}: {state}{failures}, last call {} ago{filming}\n  {}",
        worker.worker_id,
        worker.host,
        duration_text(worker.silent_secs),
        runs_on(
            &worker.asset_pack,
            &worker.mujoco_version,
            &worker.renderer,
            &worker.look,
            &worker.program_version
        )
    )
}
