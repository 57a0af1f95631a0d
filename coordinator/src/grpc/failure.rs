//! Conversion of errors to gRPC statuses; the code tells the client whether to retry.

use std::path::Path;

use queue::{ArtifactError, QueueError, StoreError};
use tonic::{Code, Response, Status};
use transport::chain;

use crate::disk::Room;
use crate::reading::ReadError;

/// Result of a gRPC handler.
pub(super) type Answer<T> = Result<Response<T>, Status>;

pub(super) fn failed(error: impl Into<ReadError>) -> Status {
    let error = error.into();
    let code = match &error {
        ReadError::Queue(error) => code(error),
        _ => Code::Internal,
    };
    if let ReadError::Queue(QueueError::Store(error)) = &error {
        // The client may retry; the log informs the operator.
        tracing::error!("failed to {}", chain(error));
    }
    Status::new(code, chain(&error))
}

fn code(error: &QueueError) -> Code {
    match error {
        // Workers react to the code: on NotFound they register again, on FailedPrecondition they
        // stop.
        QueueError::UnknownWorker { .. }
        | QueueError::UnknownAttempt { .. }
        | QueueError::UnknownCampaign { .. }
        | QueueError::Renamed { .. }
        | QueueError::UnknownRollout { .. } => Code::NotFound,
        QueueError::WorkerStopped { .. }
        | QueueError::Cancelled { .. }
        | QueueError::Stopped { .. }
        | QueueError::CampaignInUse { .. }
        | QueueError::HasDerived { .. }
        | QueueError::PolicyMeasured { .. }
        | QueueError::NotQuarantined { .. }
        | QueueError::NotSkippable { .. } => Code::FailedPrecondition,
        QueueError::BackupInHand => Code::ResourceExhausted,
        QueueError::CampaignDiffers { .. } | QueueError::NameTaken { .. } => Code::AlreadyExists,
        QueueError::Unspecified { .. } => Code::InvalidArgument,
        // Waiting does not restore the data folder, so clients should not retry. Workers retry
        // anyway, to keep their outcomes.
        QueueError::Store(StoreError::Gone { .. }) => Code::Internal,
        QueueError::ShuttingDown
        | QueueError::Store(StoreError::Full { .. } | StoreError::Statement { .. }) => {
            Code::Unavailable
        }
    }
}

pub(super) fn artifact_failed(error: ArtifactError) -> Status {
    let code = match error {
        ArtifactError::Store(error) => return failed(error),
        ArtifactError::TooLarge { .. } => Code::InvalidArgument,
        ArtifactError::NoOutcome { .. } => Code::PermissionDenied,
        ArtifactError::Write { .. } => {
            tracing::error!("failed to {}", chain(&error));
            Code::Unavailable
        }
    };
    Status::new(code, chain(&error))
}

pub(super) fn invalid(error: impl std::fmt::Display) -> Status {
    Status::invalid_argument(error.to_string())
}

/// Checks that films, archives and large campaigns leave room on the data folder's disk for the results of running
/// rollouts.
pub(super) fn check_room(folder: &Path, min_free_bytes: u64, doing: &str) -> Result<(), Status> {
    let room = Room::measure(folder, min_free_bytes);
    if room.free_bytes >= room.needed_bytes {
        return Ok(());
    }
    Err(Status::resource_exhausted(format!(
        "{doing}: the disk of the coordinator's data folder has {} MiB left, which results need; \
         make room",
        room.free_bytes >> 20
    )))
}
