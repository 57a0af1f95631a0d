//! Errors as statuses: their words, and the code that says what to do.

use queue::{ArtifactError, QueueError, StoreError};
use tonic::{Code, Status};
use transport::chain;

use crate::export::ExportError;
use crate::report::ReportError;

pub(super) fn store_failed(error: &StoreError) -> Status {
    // The client may retry; the operator must know.
    let text = chain(error);
    tracing::error!("failed to {text}");
    Status::unavailable(text)
}

pub(super) fn queue_failed(error: QueueError) -> Status {
    let code = match &error {
        QueueError::Store(error) => return store_failed(error),
        // A worker that is not found registers again; one that fails the
        // precondition must stop.
        QueueError::UnknownWorker { .. }
        | QueueError::UnknownAttempt { .. }
        | QueueError::UnknownCampaign { .. }
        | QueueError::UnknownRollout { .. } => Code::NotFound,
        QueueError::WorkerStopped { .. }
        | QueueError::Cancelled { .. }
        | QueueError::CampaignInUse { .. }
        | QueueError::NotQuarantined { .. } => Code::FailedPrecondition,
        QueueError::BackupInHand => Code::ResourceExhausted,
        QueueError::CampaignDiffers { .. } => Code::AlreadyExists,
        QueueError::ShuttingDown => Code::Unavailable,
    };
    Status::new(code, chain(&error))
}

pub(super) fn artifact_failed(error: ArtifactError) -> Status {
    let code = match &error {
        ArtifactError::Store(error) => return store_failed(error),
        ArtifactError::TooLarge { .. } => Code::InvalidArgument,
        ArtifactError::NoOutcome { .. } => Code::PermissionDenied,
        ArtifactError::Write { .. } => {
            tracing::error!("failed to {}", chain(&error));
            Code::Unavailable
        }
    };
    Status::new(code, chain(&error))
}

pub(super) fn report_failed(error: ReportError) -> Status {
    match error {
        ReportError::Queue(error) => queue_failed(error),
        error => Status::internal(chain(&error)),
    }
}

pub(super) fn export_failed(error: ExportError) -> Status {
    match error {
        ExportError::Queue(error) => queue_failed(error),
        error => Status::internal(chain(&error)),
    }
}
