//! Sends batches to one server: a task takes queries from the queue and distributes the answers.
//! A batch ends early if its server does not answer in time, or if no caller waits for its answers
//! any more. The replica decides which queries enter the queue.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use policy_backends::{Backend, BackendError};
use proto::policy::{InferRequest, InferResponse};
use tokio::sync::{Notify, oneshot};
use tokio::task::JoinSet;

use super::{MAX_QUEUED, Next, Queue};
use crate::pace::{NoAnswer, Watch};

/// Queue of queries with the task that empties it. Dropping the batcher ends the task.
pub struct Batcher {
    shared: Arc<Shared>,
    /// The task, which starts with the first query.
    driver: Mutex<JoinSet<()>>,
}

struct Shared {
    backend: Arc<dyn Backend>,
    watch: Arc<Watch>,
    answer_within: Duration,
    /// Waiting queries, and the largest batch size, as given with the latest query.
    queue: Mutex<(Queue<Query>, usize)>,
    changed: Notify,
}

struct Query {
    request: InferRequest,
    is_sent: Arc<AtomicBool>,
    answer: oneshot::Sender<Result<InferResponse, BackendError>>,
}

impl Batcher {
    pub fn new(backend: Arc<dyn Backend>, watch: Arc<Watch>, answer_within: Duration) -> Self {
        Self {
            shared: Arc::new(Shared {
                backend,
                watch,
                answer_within,
                queue: Mutex::new((Queue::default(), 1)),
                changed: Notify::new(),
            }),
            driver: Mutex::default(),
        }
    }

    /// Answers one query as part of a batch of at most `size`. Waits for at most `patience` until
    /// the batch is sent. Dropping the future removes the query from the queue.
    pub async fn infer(
        &self,
        request: InferRequest,
        size: usize,
        patience: Duration,
    ) -> Result<InferResponse, BackendError> {
        let (answer, mut answered) = oneshot::channel();
        let is_sent = Arc::new(AtomicBool::new(false));
        {
            let mut queue = self.shared.queue();
            queue.1 = size;
            let query = Query { request, is_sent: Arc::clone(&is_sent), answer };
            queue
                .0
                .push(query, Instant::now())
                .map_err(|_| BackendError::QueueFull { queued: MAX_QUEUED })?;
        }
        self.start_task();
        self.shared.changed.notify_one();
        let answer = match tokio::time::timeout(patience, &mut answered).await {
            Ok(answer) => answer,
            Err(_) if is_sent.load(Ordering::Relaxed) => answered.await,
            Err(_) => {
                return Err(BackendError::Overloaded {
                    backend: self.shared.backend.to_string(),
                    waited: patience,
                });
            }
        };
        answer.unwrap_or(Err(BackendError::BatchLost))
    }

    /// Starts the task unless it is running.
    fn start_task(&self) {
        let mut driver = self.driver.lock().unwrap_or_else(PoisonError::into_inner);
        while driver.try_join_next().is_some() {}
        if driver.is_empty() {
            driver.spawn(send_batches(Arc::clone(&self.shared)));
        }
    }
}

impl Shared {
    fn queue(&self) -> std::sync::MutexGuard<'_, (Queue<Query>, usize)> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn next(&self) -> Next<Query> {
        let (queue, size) = &mut *self.queue();
        // A caller that stopped waiting needs no answer, and its query is not sent.
        queue.forget(|query| query.answer.is_closed());
        queue.next(*size, Instant::now())
    }
}

async fn send_batches(shared: Arc<Shared>) {
    let mut in_flight = JoinSet::new();
    loop {
        let wait = match shared.next() {
            Next::Send(batch) => {
                in_flight.spawn(send(Arc::clone(&shared), batch));
                continue;
            }
            Next::WaitUntil(time) => Some(time),
            Next::Nothing => None,
        };
        let wait_over = async {
            match wait {
                Some(time) => tokio::time::sleep_until(time.into()).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            // A batch whose task panicked counts as done; its callers get `BatchLost`.
            Some(_) = in_flight.join_next() => shared.queue().0.done(),
            () = shared.changed.notified() => {}
            () = wait_over => {}
        }
    }
}

/// Sends one batch and distributes its answers. Drops the call once no caller waits for an answer,
/// which cancels the request at the server.
async fn send(shared: Arc<Shared>, batch: Vec<Query>) {
    let mut requests = Vec::with_capacity(batch.len());
    let mut callers = Vec::with_capacity(batch.len());
    for query in batch {
        query.is_sent.store(true, Ordering::Relaxed);
        requests.push(query.request);
        callers.push(query.answer);
    }
    let limit = shared.answer_within;
    let call = shared.backend.infer_batch(requests);
    let call = shared.watch.queries(limit, call, |answers| match answers {
        Ok(answers) => answers.len() as u32,
        Err(error) => u32::from(!error.is_outage()),
    });
    let all_callers_gone = async {
        for caller in &mut callers {
            caller.closed().await;
        }
    };
    let answers = tokio::select! {
        answers = call => answers,
        () = all_callers_gone => return,
    };
    match answers {
        Ok(Ok(answers)) => {
            for (caller, answer) in callers.into_iter().zip(answers) {
                // The caller may have stopped waiting.
                drop(caller.send(answer));
            }
        }
        Ok(Err(error)) => fail(callers, &error),
        Err(NoAnswer) => {
            let error = BackendError::TimedOut { backend: shared.backend.to_string(), limit };
            let waiting = shared.queue().0.drain();
            fail(waiting.into_iter().map(|query| query.answer), &error);
            fail(callers, &error);
        }
    }
}

fn fail(
    callers: impl IntoIterator<Item = oneshot::Sender<Result<InferResponse, BackendError>>>,
    error: &BackendError,
) {
    for caller in callers {
        drop(caller.send(Err(error.clone())));
    }
}

#[cfg(test)]
mod tests {
    use std::fmt;
    use std::sync::atomic::AtomicBool;

    use proto::policy::{DescribeResponse, ResetRequest};

    use super::*;

    /// A back-end that panics at its first batch.
    #[derive(Default)]
    struct PanickingBackend(AtomicBool);

    impl fmt::Display for PanickingBackend {
        fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("panicking")
        }
    }

    #[tonic::async_trait]
    impl Backend for PanickingBackend {
        async fn describe(&self, _: &str) -> Result<DescribeResponse, BackendError> {
            Ok(DescribeResponse::default())
        }

        async fn reset(&self, _: ResetRequest) -> Result<(), BackendError> {
            Ok(())
        }

        async fn infer(&self, _: InferRequest) -> Result<InferResponse, BackendError> {
            assert!(self.0.swap(true, Ordering::Relaxed), "the first batch");
            Ok(InferResponse::default())
        }
    }

    #[tokio::test]
    async fn a_batch_whose_task_panics_is_lost_as_an_outage_and_the_next_batch_is_answered() {
        let backend = Arc::new(PanickingBackend::default());
        let patience = Duration::from_secs(60);
        let batcher = Batcher::new(backend, Arc::default(), patience);
        let lost = batcher.infer(InferRequest::default(), 2, patience).await;
        let lost = lost.expect_err("the batch panicked");
        assert!(matches!(lost, BackendError::BatchLost) && lost.is_outage());
        let next = batcher.infer(InferRequest::default(), 2, patience).await;
        next.expect("the batcher continues");
    }
}
