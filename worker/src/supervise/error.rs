//! Errors that end a worker.

use std::io;

use rollout_types::AttemptIdError;
use transport::{AccessError, EndpointError};

use super::slot_state::MAX_FAILED_STARTS;

/// Reason why a worker ended unasked.
#[derive(Debug, thiserror::Error)]
pub enum SuperviseError {
    /// The coordinator's address is not a valid URL.
    #[error(transparent)]
    Endpoint(#[from] EndpointError),
    /// The coordinator cannot be called over TLS.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// The coordinator refused this worker.
    #[error("register with the coordinator at {url}: {answer}")]
    Refused {
        /// URL of the coordinator.
        url: String,
        /// The coordinator's reason.
        answer: String,
    },
    /// The coordinator stopped this worker.
    #[error("go on working: the coordinator stopped this worker because {0}")]
    Stopped(String),
    /// The coordinator granted a lease with an invalid attempt id.
    #[error("take a lease of the coordinator at {url}")]
    Lease {
        /// URL of the coordinator.
        url: String,
        /// Fault of the attempt id.
        #[source]
        source: AttemptIdError,
    },
    /// A task of the worker panicked, which is a defect.
    #[error("go on working: a part of this worker broke off ({0}); this is a defect")]
    Panicked(String),
    /// The slots have different renderers, whose pixels would differ.
    #[error(
        "keep slot {slot}: it draws with `{renderer}` and this worker is registered with \
         `{registered}`; start one worker for each renderer"
    )]
    Renderers {
        /// Number of the slot, from 0.
        slot: usize,
        /// Renderer of the slot.
        renderer: String,
        /// Renderer of the slot that was ready first.
        registered: String,
    },
    /// The machine's limits allow no further process.
    #[error("start slot {slot}: the machine has nothing left for it; use fewer --slots")]
    Exhausted {
        /// Number of the slot, from 0.
        slot: usize,
        /// Error of the system that names the exhausted limit.
        #[source]
        error: io::Error,
    },
    /// A slot's process repeatedly ended before it finished a rollout.
    #[error(
        "keep slot {slot} running: its process ended {MAX_FAILED_STARTS} times in a row without \
         finishing a rollout; the last one {end}"
    )]
    Slot {
        /// Number of the slot, from 0.
        slot: usize,
        /// Description of the process's end.
        end: String,
    },
}
