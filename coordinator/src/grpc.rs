//! gRPC services: validate requests, call the queue, and convert its results and errors to messages
//! and statuses. The queue makes all scheduling decisions.

mod archives;
mod backup;
mod detached;
mod failure;
mod operator;
mod read;
mod streams;
mod worker;

use std::sync::Arc;

use proto::coordinator::operator_service_server::OperatorServiceServer;
use proto::coordinator::worker_service_server::WorkerServiceServer;
use queue::Queue;
use tonic::service::Routes;

use crate::gauges::Gauges;
use crate::storage::Storage;

use detached::Detached;
use operator::OperatorApi;
use streams::Turns;
use worker::WorkerApi;

/// Largest accepted message of a worker, bytes. A video chunk takes a quarter of a megabyte, all
/// other messages far less.
const MAX_WORKER_MESSAGE_BYTES: usize = 2 << 20;

pub(crate) fn services(
    queue: &Arc<Queue>,
    gauges: &Arc<Gauges>,
    storage: Option<&Arc<Storage>>,
    min_free_bytes: u64,
) -> axum::Router {
    let (queue, gauges) = (queue.clone(), gauges.clone());
    let operator = OperatorApi {
        queue: queue.clone(),
        changes: Detached::default(),
        storage: storage.cloned(),
        turns: Turns::default(),
        min_free_bytes,
    };
    let worker = WorkerServiceServer::new(WorkerApi { queue, gauges, min_free_bytes })
        .max_decoding_message_size(MAX_WORKER_MESSAGE_BYTES)
        .max_encoding_message_size(proto::MAX_MESSAGE_BYTES);
    let operator = OperatorServiceServer::new(operator)
        .max_decoding_message_size(proto::MAX_MESSAGE_BYTES)
        .max_encoding_message_size(proto::MAX_MESSAGE_BYTES);
    Routes::new(worker).add_service(operator).into_axum_router()
}
