//! Data types shared by the coordinator, the workers and the report: ids, results and provenance of
//! attempts at a rollout, and retry back-off. A result and its provenance are the same JSON in the
//! slot's messages, on the wire and in the database.

mod backoff;
mod capsule;
mod id;
mod provenance;
mod realised;
mod result;

pub use backoff::{Backoff, Waits};
pub use capsule::Capsule;
pub use id::{AttemptId, AttemptIdError, shortened};
pub use provenance::{
    CONNECTED_SINCE, Digests, EXECUTION, Fingerprints, MAX_PACKAGES, MAX_SETTINGS, MAX_TEXT_BYTES,
    Pin, Provenance, SOFTWARE_RENDERER, TAUGHT_ON, TAUGHT_ON_LOOK, UNNAMED_CHECKPOINT, first_names,
};
pub use realised::{Realised, RealisedAxis, TOLERANCE};
pub use result::{
    GoalProgress, IkResidual, MAX_PROMPT_BYTES, Measurement, Motion, Parts, RolloutResult,
    tenths_of_mm,
};
