//! Errors that end a worker.

use std::io;

use benchmark::attempt::AttemptIdError;
use transport::{AccessError, EndpointError};

use super::slot_state::MAX_FAILED_STARTS;

/// Reason why a worker ended without being asked to.
#[derive(Debug, thiserror::Error)]
pub enum SuperviseError {
    #[error(transparent)]
    Endpoint(#[from] EndpointError),
    #[error(transparent)]
    Access(#[from] AccessError),
    #[error("register with the coordinator at {url}: {answer}")]
    Refused { url: String, answer: String },
    #[error("continue: the coordinator stopped this worker because {0}")]
    Stopped(String),
    #[error("take a lease of the coordinator at {url}")]
    Lease { url: String, source: AttemptIdError },
    #[error("continue: a task of this worker panicked ({0}); this is a defect")]
    Panicked(String),
    #[error(
        "keep slot {slot}: its renderer is `{renderer}` and this worker is registered with \
         `{registered}`; start one worker for each renderer"
    )]
    Renderers { slot: usize, renderer: String, registered: String },
    #[error("start slot {slot}: the machine's limits allow no further process; use fewer --slots")]
    Exhausted {
        slot: usize,
        #[source]
        error: io::Error,
    },
    #[error(
        "keep slot {slot} running: its process ended {MAX_FAILED_STARTS} times in a row without \
         finishing a rollout; the last one {end}"
    )]
    Slot { slot: usize, end: String },
}
