//! Named background tasks, so that the queue can report the name of a task that has ended.

use std::collections::HashMap;
use std::future::Future;

use tokio::task::{Id, JoinSet};

use crate::store::failpoint;

/// Background tasks, aborted on drop. A task ends by itself only if it panics.
#[derive(Debug, Default)]
pub struct Tasks {
    running: JoinSet<()>,
    names: HashMap<Id, &'static str>,
}

impl Tasks {
    /// Starts a task. Its name is the subject of a sentence: "the sweep".
    pub fn spawn(&mut self, name: &'static str, work: impl Future<Output = ()> + Send + 'static) {
        let task = self.running.spawn(async move {
            failpoint::panic_in(name);
            work.await;
        });
        self.names.insert(task.id(), name);
    }

    /// Waits until one of the tasks ends, and returns its name.
    pub async fn next_ended(&mut self) -> &'static str {
        let ended = match self.running.join_next_with_id().await {
            Some(Ok((id, ()))) => Some(id),
            Some(Err(error)) => Some(error.id()),
            None => None,
        };
        let name = ended.and_then(|id| self.names.get(&id));
        name.copied().unwrap_or("a background task")
    }

    /// Aborts the tasks and waits until they have ended.
    pub async fn shutdown(&mut self) {
        self.running.shutdown().await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_task_that_panics_is_named() {
        for panicking in ["first", "second"] {
            let mut tasks = Tasks::default();
            for name in ["first", "second"] {
                tasks.spawn(name, async move {
                    assert_ne!(name, panicking, "a defect");
                    std::future::pending().await
                });
            }
            assert_eq!(tasks.next_ended().await, panicking);
        }
    }
}
