//! Changes of campaigns, which run to their end even if the client disconnects meanwhile.
//!
//! tonic drops a call's future when its client goes away. Dropped between the database's COMMIT
//! and the notifications after it, a change would be stored and nobody would be woken: a campaign
//! that follows from another would have no rollouts until something else settles.

use std::future::Future;
use std::sync::{Mutex, PoisonError};

use tokio::sync::oneshot;
use tokio::task::JoinSet;
use tonic::Status;

/// The changes that are under way.
#[derive(Debug, Default)]
pub(super) struct Detached(Mutex<JoinSet<()>>);

impl Detached {
    /// Runs a change in a task of its own, and returns its result.
    pub(super) async fn run<T: Send + 'static>(
        &self,
        change: impl Future<Output = T> + Send + 'static,
    ) -> Result<T, Status> {
        let (sender, result) = oneshot::channel();
        {
            let mut tasks = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            // Ended tasks are removed: a panic among them was in the answer of its call.
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
