//! The wire: checks what strangers send, calls the queue, and turns its answers
//! and errors into messages. Nothing is decided here.

pub(crate) mod access;
mod backup;
mod listing;
mod operator;
mod read;
mod worker;

use std::error::Error;
use std::sync::Arc;

use proto::coordinator::operator_service_server::OperatorServiceServer;
use proto::coordinator::worker_service_server::WorkerServiceServer;
use tonic::service::Routes;
use tonic::{Code, Status};

use crate::artifacts::ArtifactError;
use crate::export::ExportError;
use crate::page::Gauges;
use crate::queue::{Queue, QueueError};
use crate::report::ReportError;
use crate::store::StoreError;

use operator::OperatorApi;
use worker::WorkerApi;

/// Largest message of a worker, bytes: a piece of a video takes a quarter of a
/// megabyte, everything else far less.
const MAX_WORKER_MESSAGE_BYTES: usize = 2 << 20;

/// The services for workers and operators, on a queue.
pub(crate) fn services(queue: &Arc<Queue>, gauges: &Arc<Gauges>) -> axum::Router {
    let worker = WorkerServiceServer::new(WorkerApi::new(queue.clone(), gauges.clone()))
        .max_decoding_message_size(MAX_WORKER_MESSAGE_BYTES)
        .max_encoding_message_size(proto::MAX_MESSAGE_BYTES);
    let operator = OperatorServiceServer::new(OperatorApi::new(queue.clone()))
        .max_decoding_message_size(proto::MAX_MESSAGE_BYTES)
        .max_encoding_message_size(proto::MAX_MESSAGE_BYTES);
    Routes::new(worker).add_service(operator).into_axum_router()
}

/// An error with its causes, on one line.
fn chain(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        text.push_str(": ");
        text.push_str(&inner.to_string());
        cause = inner.source();
    }
    text
}

fn store_failed(error: &StoreError) -> Status {
    // The client may retry; the operator must know.
    let text = chain(error);
    tracing::error!("failed to {text}");
    Status::unavailable(text)
}

fn queue_failed(error: QueueError) -> Status {
    let code = match &error {
        QueueError::Store(error) => return store_failed(error),
        // A worker that is not found registers again; one that fails the
        // precondition must stop.
        QueueError::UnknownWorker { .. }
        | QueueError::UnknownJob { .. }
        | QueueError::UnknownCampaign { .. }
        | QueueError::UnknownRollout { .. } => Code::NotFound,
        QueueError::WorkerStopped { .. }
        | QueueError::Cancelled { .. }
        | QueueError::CampaignInUse { .. }
        | QueueError::NotSetAside { .. } => Code::FailedPrecondition,
        QueueError::BackupInHand => Code::ResourceExhausted,
        QueueError::CampaignDiffers { .. } => Code::AlreadyExists,
        QueueError::ShuttingDown => Code::Unavailable,
    };
    Status::new(code, chain(&error))
}

fn artifact_failed(error: ArtifactError) -> Status {
    let code = match &error {
        ArtifactError::Store(error) => return store_failed(error),
        ArtifactError::Name { .. } | ArtifactError::TooLarge { .. } => Code::InvalidArgument,
        ArtifactError::NotTheOwner { .. } => Code::PermissionDenied,
        ArtifactError::Write { .. } => {
            tracing::error!("failed to {}", chain(&error));
            Code::Unavailable
        }
    };
    Status::new(code, chain(&error))
}

fn report_failed(error: ReportError) -> Status {
    match error {
        ReportError::Queue(error) => queue_failed(error),
        error => Status::internal(chain(&error)),
    }
}

fn export_failed(error: ExportError) -> Status {
    match error {
        ExportError::Queue(error) => queue_failed(error),
        error => Status::internal(chain(&error)),
    }
}
