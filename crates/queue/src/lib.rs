//! The job table: rollouts to run, the leases of workers, and results. Independent of the wire
//! protocol, the web page, the simulator and policies.
//!
//! [`rules`] are pure decisions. `operations` read the inputs of a decision, apply the rules and
//! write the outcome, with one transaction for all requests that arrive together. `store` holds the
//! SQL statements. [`View`] reads for the web page, the command line and reports. [`Queue`] is the
//! entry point.

#![forbid(unsafe_code)]

pub mod clock;
pub mod expand;
pub mod ids;
pub mod invariants;
mod operations;
mod queue;
pub mod read;
mod remote_storage;
pub mod rules;
mod store;
mod tasks;
mod timing;

pub use operations::alter::Alteration;
pub use operations::append::AppendedRow;
pub use operations::artifacts::{
    ARTIFACTS_FOLDER, ArtifactError, MAX_ARTIFACT_BYTES, MOVING_PREFIX, Upload,
    remove_partial_files,
};
pub use operations::backup::Backup;
pub use operations::campaigns::Created;
pub use operations::claim::{Assigned, ClaimRequest, Claimed, MAX_CLAIM_WAIT, Means};
pub use operations::commit::{CommitReply, CommitReport, CommitVerdict};
pub use operations::error::QueueError;
pub use operations::films::Film;
pub use operations::local_videos::{FilmRemoval, LocalFilm};
pub use operations::portable::{
    AdoptError, CopyError, FilmFile, Portable, PortableError, ROLLOUTS_FILE, SourceOutcomes,
    film_attempt,
};
pub use operations::release::{ReleaseReply, ReleaseVerdict};
pub use operations::retry::{MAX_JOBS_RETRIED, Retry};
pub use queue::Queue;
pub use read::View;
pub use remote_storage::RemoteStorage;
pub use store::failpoint::{FAILPOINT_VARIABLE, PANIC_VARIABLE, Side, Step};
pub use store::workers::{MAX_SLOTS, WorkerInfo};
pub use store::{DATABASE_FILE, OpenError, Store, StoreError, newest_known_schema};
pub use tasks::Tasks;
pub use timing::Timing;
