//! Durations of leases, heartbeats and timeouts.

use std::time::Duration;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// Duration of a lease from its grant or its last heartbeat. `claim`, `heartbeat`, `resume` and
    /// `start` add it, as one instant for all leases of a statement; `sweep` judges by that instant.
    pub lease: Duration,
    /// Interval between the heartbeats of a worker.
    pub heartbeat: Duration,
    /// Time without progress after which a worker kills a rollout.
    pub progress_timeout: Duration,
    /// Time that an attempt may take per control step of its budget, settling included; past that,
    /// its lease is not renewed.
    pub ceiling_per_step: Duration,
    /// Time after its last call for which a worker counts as alive, unless it has signed off.
    /// Equals the duration of a lease.
    pub worker_alive: Duration,
    /// Interval between sweeps for expired leases.
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
