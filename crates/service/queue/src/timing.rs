//! Durations of leases, heartbeats and timeouts.

use std::time::Duration;

/// Durations of leases, heartbeats and timeouts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// A lease, from its grant or its last heartbeat.
    pub lease: Duration,
    /// Between two heartbeats.
    pub heartbeat: Duration,
    /// A rollout whose progress stops for so long is killed by its worker.
    pub progress_timeout: Duration,
    /// An attempt may take so long for each control step of its budget, settling
    /// included; after that its lease is renewed no more.
    pub ceiling_per_step: Duration,
    /// A worker counts as alive for so long after its last call, unless it has
    /// said good-bye: as long as its leases last without a heartbeat.
    pub worker_alive: Duration,
    /// Between two looks for expired leases.
    pub sweep: Duration,
}

impl Default for Timing {
    fn default() -> Timing {
        Timing {
            lease: Duration::from_secs(30),
            heartbeat: Duration::from_secs(5),
            progress_timeout: Duration::from_secs(180),
            ceiling_per_step: Duration::from_secs(10),
            worker_alive: Duration::from_secs(30),
            sweep: Duration::from_secs(1),
        }
    }
}
