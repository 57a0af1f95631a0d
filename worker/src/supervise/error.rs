//! Errors that end a worker.

use std::io;

use rollout_types::AttemptIdError;
use transport::{AccessError, EndpointError};

use super::slot_state::MAX_FAILED_STARTS;

/// Reason for which a worker ended without a request to end.
#[derive(Debug, thiserror::Error)]
pub enum SuperviseError {
    /// The coordinator's URL is none.
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
        /// Reason in the coordinator's words.
        answer: String,
    },
    /// The coordinator stopped this worker.
    #[error("go on working: the coordinator stopped this worker because {0}")]
    Stopped(String),
    /// A lease has no name.
    #[error("take a lease of the coordinator at {url}")]
    Lease {
        /// URL of the coordinator.
        url: String,
        /// Fault of the name.
        #[source]
        source: AttemptIdError,
    },
    /// A defect of this program.
    #[error("go on working: a part of this worker broke off ({0}); this is a defect")]
    Panicked(String),
    /// The slots would draw different pictures.
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
    /// The machine has nothing left for another process.
    #[error("start slot {slot}: the machine has nothing left for it; use fewer --slots")]
    Exhausted {
        /// Number of the slot, from 0.
        slot: usize,
        /// The limit that was reached.
        #[source]
        error: io::Error,
    },
    /// A slot's process does not survive its start.
    #[error(
        "keep slot {slot} running: its process ended {MAX_FAILED_STARTS} times in a row without \
         finishing a rollout; the last one {end}"
    )]
    Slot {
        /// Number of the slot, from 0.
        slot: usize,
        /// End of the process, in words.
        end: String,
    },
}
