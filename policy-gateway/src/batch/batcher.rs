//! Sends batches to one server: a task takes queries from the queue, and every
//! query gets its own answer back. Responsible for ending a batch that is not
//! answered in time; which queries may be asked at all is the replica's business.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use proto::policy::{InferRequest, InferResponse};
use tokio::{
    sync::{Notify, oneshot},
    task::JoinSet,
};

use super::{MAX_QUEUED, Next, Queue};
use crate::backend::{Backend, BackendError};

/// A queue of queries and the task that empties it, which ends with this.
pub struct Batcher {
    shared: Arc<Shared>,
    /// The task, from the first query on.
    driver: Mutex<JoinSet<()>>,
}

struct Shared {
    backend: Arc<dyn Backend>,
    answer_within: Duration,
    /// Queries, and the largest batch as last reported.
    queue: Mutex<(Queue<Query>, usize)>,
    changed: Notify,
}

struct Query {
    request: InferRequest,
    answer: oneshot::Sender<Result<InferResponse, BackendError>>,
}

impl Batcher {
    /// A batcher for this back-end, without queries.
    pub fn new(backend: Arc<dyn Backend>, answer_within: Duration) -> Self {
        Self {
            shared: Arc::new(Shared {
                backend,
                answer_within,
                queue: Mutex::new((Queue::default(), 1)),
                changed: Notify::new(),
            }),
            driver: Mutex::default(),
        }
    }

    /// Answers one query as part of a batch of at most `size`.
    ///
    /// # Errors
    /// When too many wait already, and as [`Backend::infer`].
    pub async fn infer(
        &self,
        request: InferRequest,
        size: usize,
    ) -> Result<InferResponse, BackendError> {
        let (answer, answered) = oneshot::channel();
        {
            let mut queue = self.shared.queue();
            queue.1 = size;
            let query = Query { request, answer };
            queue
                .0
                .push(query, Instant::now())
                .map_err(|_| BackendError::QueueFull { queued: MAX_QUEUED })?;
        }
        self.drive();
        self.shared.changed.notify_one();
        answered.await.unwrap_or(Err(BackendError::BatchLost))
    }

    /// Starts the task if it does not run.
    fn drive(&self) {
        let mut driver = self.driver.lock().unwrap_or_else(PoisonError::into_inner);
        while driver.try_join_next().is_some() {}
        if driver.is_empty() {
            driver.spawn(drive(Arc::clone(&self.shared)));
        }
    }
}

impl Shared {
    fn queue(&self) -> std::sync::MutexGuard<'_, (Queue<Query>, usize)> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn next(&self) -> Next<Query> {
        let (queue, size) = &mut *self.queue();
        // A caller that stopped waiting needs no answer and holds no place.
        queue.forget(|query| query.answer.is_closed());
        queue.next(*size, Instant::now())
    }
}

async fn drive(shared: Arc<Shared>) {
    let mut under_way = JoinSet::new();
    loop {
        let wait = match shared.next() {
            Next::Send(batch) => {
                under_way.spawn(send(Arc::clone(&shared), batch));
                continue;
            }
            Next::WaitUntil(then) => Some(then),
            Next::Nothing => None,
        };
        let ripe = async {
            match wait {
                Some(then) => tokio::time::sleep_until(then.into()).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            // A batch that panicked is done, too; its queries are answered.
            Some(_) = under_way.join_next() => shared.queue().0.done(),
            () = shared.changed.notified() => {}
            () = ripe => {}
        }
    }
}

/// Sends one batch and passes its answers on.
async fn send(shared: Arc<Shared>, batch: Vec<Query>) {
    let (requests, askers): (Vec<_>, Vec<_>) =
        batch.into_iter().map(|it| (it.request, it.answer)).unzip();
    let limit = shared.answer_within;
    let answers = tokio::time::timeout(limit, shared.backend.infer_batch(requests)).await;
    let answers = answers.unwrap_or_else(|_| {
        Err(BackendError::TimedOut {
            backend: shared.backend.to_string(),
            limit,
        })
    });
    match answers {
        Ok(answers) => {
            for (asker, answer) in askers.into_iter().zip(answers) {
                // A caller that stopped waiting needs no answer.
                drop(asker.send(answer));
            }
        }
        Err(error) => {
            for asker in askers {
                drop(asker.send(Err(error.clone())));
            }
        }
    }
}
