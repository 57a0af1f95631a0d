//! The words that the coordinator, the workers and the report share: an attempt
//! at a rollout, what it came to, where that came from, and how long to wait
//! before the next one. Pure data: storage, wire and report convert at their
//! own edges.

#![forbid(unsafe_code)]

mod backoff;
mod id;
mod provenance;
mod realised;
mod result;

pub use backoff::{Backoff, Waits};
pub use id::{AttemptId, AttemptIdError};
pub use provenance::{
    Digests, EXECUTION, Fingerprints, Pin, Provenance, SOFTWARE_RENDERER, TAUGHT_ON,
};
pub use realised::{Realised, RealisedAxis, TOLERANCE};
pub use result::{GoalProgress, IkResidual, Motion, Parts, RolloutResult};
