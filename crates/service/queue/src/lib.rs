//! The job table: what is to be run, which worker holds it, what came out. It
//! knows no wire, no page, no simulator and no policy.
//!
//! [`rules`] decide purely; `operations` read what a decision needs, let the
//! rules decide and carry it out, one transaction for all that arrives
//! together; `store` holds their statements. [`View`] is for
//! reading: the page, the command line and reports. [`Queue`] is the way in.

#![forbid(unsafe_code)]

pub mod clock;
mod elsewhere;
pub mod expand;
pub mod ids;
pub mod invariants;
mod operations;
mod queue;
pub mod read;
pub mod rules;
mod store;
mod timing;

pub use elsewhere::Elsewhere;
pub use operations::alter::Alteration;
pub use operations::artifacts::{
    ARTIFACTS_FOLDER, ArtifactError, MAX_ARTIFACT_BYTES, MOVING_PREFIX, Upload,
    remove_partial_files,
};
pub use operations::backup::Backup;
pub use operations::campaigns::Created;
pub use operations::claim::{Assigned, ClaimRequest, Claimed, MAX_CLAIM_WAIT};
pub use operations::commit::{CommitReply, CommitReport, CommitVerdict};
pub use operations::error::QueueError;
pub use operations::films::Film;
pub use operations::films_here::{FilmHere, Forgotten};
pub use operations::merge::{MergeError, Merged, merge};
pub use operations::portable::{
    AdoptError, CopyError, FilmFile, Portable, PortableError, SourceOutcomes,
};
pub use operations::release::{ReleaseReply, ReleaseVerdict};
pub use operations::retry::{MAX_JOBS_RETRIED, Retry};
pub use queue::Queue;
pub use read::View;
pub use store::failpoint::{FAILPOINT_VARIABLE, Side, Step};
pub use store::workers::WorkerInfo;
pub use store::{DATABASE_FILE, OpenError, Store, StoreError, newest_known_schema};
pub use timing::Timing;
