//! Data types shared by the coordinator, the workers and the report: ids, results and provenance of
//! attempts at a rollout, and retry back-off. Storage, wire protocol and report convert from and to
//! them at their own boundaries.

#![forbid(unsafe_code)]

mod backoff;
mod id;
mod provenance;
mod realised;
mod result;

pub use backoff::{Backoff, Waits};
pub use id::{AttemptId, AttemptIdError};
pub use provenance::{
    CONNECTED_SINCE, Digests, EXECUTION, Fingerprints, Pin, Provenance, SOFTWARE_RENDERER,
    TAUGHT_ON, TAUGHT_ON_LOOK, UNNAMED_CHECKPOINT, first_names,
};
pub use realised::{Realised, RealisedAxis, TOLERANCE};
pub use result::{GoalProgress, IkResidual, Motion, Parts, RolloutResult};
