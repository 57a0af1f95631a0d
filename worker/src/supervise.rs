//! The worker's parent process: leases jobs, assigns them to slots, renews the leases, delivers
//! results, and replaces slots that crash or hang. One loop (`supervisor`) owns all state; tasks
//! run single calls and processes and report to the loop. Simulation happens only in the slots'
//! processes.

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
pub use slot_state::START_DEADLINE;
use supervisor::Supervisor;

/// Capacity of the loop's event queue; senders wait while it is full.
const EVENT_QUEUE: usize = 256;

/// Runs a worker until it is asked to end, has been idle for too long or has a fault, and then
/// until its rollouts in flight are over. `shutdown` carries one message per request; the second
/// request gives the rollouts back.
pub async fn run(config: Config, shutdown: mpsc::Receiver<()>) -> Result<(), SuperviseError> {
    let (drain, draining) = watch::channel(false);
    let link = Link::new(&config.coordinator, &config.access, config.seed, draining)?;
    let (events, inbox) = mpsc::channel(EVENT_QUEUE);
    let supervisor = Supervisor::new(config, link, drain, events, Instant::now());
    supervisor.serve(inbox, shutdown).await
}
