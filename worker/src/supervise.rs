//! The worker's parent process: leases jobs, hands them to its slots, keeps the
//! leases alive, delivers results, and replaces slots that crash or hang. One
//! loop (`supervisor`) owns all state; tasks own single calls and single
//! processes, and tell the loop what came of them. Not responsible for simulating
//! anything: that is a slot's, in a process of its own.

mod config;
mod deliver;
mod error;
mod event;
pub(crate) mod link;
mod process;
mod slot_state;
mod supervisor;
mod upload;

use tokio::sync::{mpsc, watch};
use tokio::time::Instant;

pub use config::{Config, Identity};
pub use error::SuperviseError;
use link::Link;
use supervisor::Supervisor;

/// Events that wait for the loop. While it is full, senders wait.
const EVENT_QUEUE: usize = 256;

/// Runs a worker until it is asked to end and its rollouts in flight are over.
/// `shutdown` carries one message per request to end; the second one gives the
/// rollouts back instead.
///
/// # Errors
/// If the coordinator refuses the worker or stops it, or its slots cannot run.
pub async fn run(config: Config, shutdown: mpsc::Receiver<()>) -> Result<(), SuperviseError> {
    let (drain, draining) = watch::channel(false);
    let link = Link::new(&config.coordinator, &config.access, config.seed, draining)?;
    let (events, inbox) = mpsc::channel(EVENT_QUEUE);
    let supervisor = Supervisor::new(config, link, drain, events, Instant::now());
    supervisor.serve(inbox, shutdown).await
}
