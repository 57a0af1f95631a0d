//! Runs campaign changes to completion even if the client disconnects.
//!
//! tonic drops a call's future when its client disconnects. If a change were dropped between the
//! database's COMMIT and the notifications after it, it would be stored but wake no task:
//! waiting claims would sleep until their own time limit.

use std::future::Future;
use std::sync::{Mutex, PoisonError};

use tokio::sync::oneshot;
use tokio::task::JoinSet;
use tonic::Status;

/// Tasks of the changes in progress.
#[derive(Debug, Default)]
pub(super) struct Detached(Mutex<JoinSet<()>>);

impl Detached {
    pub(super) async fn run<T: Send + 'static>(
        &self,
        change: impl Future<Output = T> + Send + 'static,
    ) -> Result<T, Status> {
        let (sender, result) = oneshot::channel();
        {
            let mut tasks = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            // Reaps finished tasks. The panic of a task was reported as the status of its call.
            while tasks.try_join_next().is_some() {}
            tasks.spawn(async move {
                // The client may have disconnected.
                let _ = sender.send(change.await);
            });
        }
        result
            .await
            .map_err(|_| Status::internal("the change panicked; the coordinator's log says where"))
    }
}
