//! Replica of a checkpoint: a back-end with its load and health. Enforces deadlines and checks all
//! answers, so that everything returned from here is safe to forward to a robot.
//!
//! A query is first *queued*, then *sent*. In the queue, only the caller's patience limits the
//! wait, and the query of a caller that gives up is removed. A sent query fails when the server has
//! answered no query for the longest allowed time.

use std::fmt;
use std::sync::atomic::{AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use policy_backends::recorder::Recorder;
use policy_backends::shorten::shorten;
use policy_backends::{Backend, BackendError, BackendSpec, Cause, UnusableBackend, description};
use proto::policy::{DescribeResponse, InferRequest, InferResponse, ResetRequest};
use tokio::sync::Semaphore;
use transport::Access;

use crate::batch::batcher::Batcher;
use crate::config::{AccessFiles, Batching, RouteSpec};
use crate::health::{Answered, Call, Health};
use crate::pace::{NoAnswer, Watch};

/// Concurrent single queries per server, which computes them one by one. Further queries wait in
/// the gateway, so that the server holds no copies of their observations.
pub const MAX_CALLS: usize = 64;
/// Sessions that a replica may have regardless of its pace: with fewer sessions, the throughput of
/// a server that answers several queries at once cannot be measured.
const MIN_SESSIONS: usize = 4;
/// Longest time per control step of a rollout: most of the 10 s that a coordinator allows
/// (`--step-ceiling-secs`).
const MAX_STEP_WAIT: Duration = Duration::from_secs(8);

/// Back-end of a checkpoint, with its load and health.
pub struct Replica {
    spec: BackendSpec,
    access: AccessFiles,
    answer_within: Duration,
    batching: Batching,
    backend: Arc<dyn Backend>,
    batcher: Batcher,
    calls: Semaphore,
    watch: Arc<Watch>,
    batch_size: AtomicUsize,
    /// Actions executed per query, from the last description.
    execute: AtomicU32,
    health: Mutex<Health>,
    /// Number of queries that are queued or sent.
    load: AtomicUsize,
    /// Sequence number, in the pool, of the last session assigned to this replica.
    last_assigned: AtomicU64,
}

/// Guard of a queued or sent query; dropping it removes the query from the load.
struct LoadGuard<'a>(&'a AtomicUsize);

impl Drop for LoadGuard<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Guard of a call in flight. If the guard is dropped before the call ends and the call was the
/// probe, the next call may probe the server at once.
struct CallGuard<'a> {
    replica: &'a Replica,
    call: Call<'a>,
    has_ended: bool,
}

impl CallGuard<'_> {
    fn end(mut self) {
        self.has_ended = true;
    }
}

impl Drop for CallGuard<'_> {
    fn drop(&mut self) {
        if !self.has_ended {
            self.replica.health().abandoned(self.call);
        }
    }
}

impl Replica {
    /// Creates a replica without calling its back-end.
    pub fn new(
        spec: &BackendSpec,
        access: &Access,
        route: &RouteSpec,
    ) -> Result<Self, UnusableBackend> {
        let RouteSpec { answer_within, batching, .. } = *route;
        let backend = spec.open(access)?;
        let backend = match &route.record {
            Some(into) => Arc::new(Recorder::new(backend, into.clone())),
            None => backend,
        };
        let watch = Arc::<Watch>::default();
        Ok(Self {
            spec: spec.clone(),
            access: route.access.clone(),
            answer_within,
            batching,
            batcher: Batcher::new(Arc::clone(&backend), Arc::clone(&watch), answer_within),
            backend,
            calls: Semaphore::new(MAX_CALLS),
            watch,
            batch_size: AtomicUsize::new(1),
            execute: AtomicU32::new(1),
            health: Mutex::default(),
            load: AtomicUsize::new(0),
            last_assigned: AtomicU64::new(0),
        })
    }

    /// Returns true if a new replica with these settings would equal this replica. Never true with
    /// access files, whose content may have changed. `record` is not compared: only `policy-gateway
    /// record` sets it, and that command never reloads.
    pub fn has_settings(&self, spec: &BackendSpec, route: &RouteSpec) -> bool {
        let settings = (spec, &self.access, route.answer_within, route.batching);
        self.access == AccessFiles::default()
            && settings == (&self.spec, &route.access, self.answer_within, self.batching)
    }

    /// Returns the number of queries that are queued or sent.
    pub fn load(&self) -> usize {
        self.load.load(Ordering::Relaxed)
    }

    pub fn last_assigned(&self) -> u64 {
        self.last_assigned.load(Ordering::Relaxed)
    }

    pub fn record_assignment(&self, number: u64) {
        self.last_assigned.store(number, Ordering::Relaxed);
    }

    pub fn answer_within(&self) -> Duration {
        self.answer_within
    }

    /// Returns the longest time of a query in the queue: 55 s if answers may take 50 s, which is
    /// below a worker's time limit of 60 s.
    fn queue_timeout(&self) -> Duration {
        self.answer_within * 11 / 10
    }

    /// Returns the server's average time per query while it is busy; `None` until known.
    pub fn per_query(&self) -> Option<Duration> {
        self.watch.per_query()
    }

    /// Returns the number of sessions that the server can answer in time; `None` until its pace is
    /// known.
    pub fn capacity(&self) -> Option<usize> {
        let execute = self.execute.load(Ordering::Relaxed);
        Some(capacity(self.queue_timeout(), execute, self.per_query()?))
    }

    /// Returns true if only probes are sent to the server.
    pub fn is_out(&self) -> bool {
        matches!(*self.health(), Health::Out(_))
    }

    /// Returns true if a call would be sent now.
    pub fn would_admit(&self, call: Call<'_>) -> bool {
        let mut health = self.health().clone();
        health.admit(call, Instant::now()).is_ok()
    }

    /// Reads the policy's description, for `suite` unless that is empty. `agrees` reports how a
    /// valid description differs from the expected description.
    pub async fn describe(
        &self,
        call: Call<'_>,
        suite: &str,
        agrees: impl FnOnce(&DescribeResponse) -> Result<(), String>,
    ) -> Result<DescribeResponse, BackendError> {
        let described = self.call_within_limit(call, self.backend.describe(suite)).await?;
        proto::checks::description(&described)
            .map_err(|fault| BackendError::Description { policy: described.name.clone(), fault })?;
        if let Err(difference) = agrees(&described) {
            let difference = shorten(&difference);
            self.record_outage(Cause::DescriptionDiffers(difference.clone()));
            return Err(BackendError::DescriptionDiffers { difference });
        }
        self.answered(Answered::Other);
        let batch_size = match self.batching {
            Batching::Dynamic => description::batch_size(&described),
            Batching::Single | Batching::Deterministic => 1,
        };
        self.batch_size.store(batch_size, Ordering::Relaxed);
        self.execute.store(described.execute, Ordering::Relaxed);
        Ok(described)
    }

    pub async fn reset(&self, request: ResetRequest) -> Result<(), BackendError> {
        let session = request.session.clone();
        self.call_within_limit(Call::InSession(&session), self.backend.reset(request)).await?;
        self.answered(Answered::Other);
        Ok(())
    }

    /// Ends an episode at the server, unless the server is out.
    pub async fn end(&self, session: &str) {
        if self.would_admit(Call::InSession(session)) {
            let _ = tokio::time::timeout(self.answer_within, self.backend.end(session)).await;
        }
        self.health().abandoned(Call::InSession(session));
    }

    /// Answers one observation of `task` with at most `horizon` actions.
    pub async fn infer(
        &self,
        request: InferRequest,
        horizon: u32,
        task: &str,
    ) -> Result<InferResponse, BackendError> {
        self.load.fetch_add(1, Ordering::Relaxed);
        let _in_flight = LoadGuard(&self.load);
        let session = request.session.clone();
        let call = Call::InSession(&session);
        let guard = self.admit(call)?;
        let answer = match self.batch_size.load(Ordering::Relaxed) {
            1 => self.infer_alone(call, request).await,
            size => self.batcher.infer(request, size, self.queue_timeout()).await,
        };
        let answer = self.record_health(answer);
        if !matches!(&answer, Err(error) if is_no_evidence(error)) {
            guard.end();
        }
        let checked =
            answer.and_then(|response| match proto::checks::actions(&response, horizon) {
                Ok(_) => Ok(response),
                Err(fault) => Err(BackendError::InvalidActions { fault }),
            });
        match checked {
            Ok(response) => {
                self.answered(Answered::Query);
                Ok(response)
            }
            Err(error) if error.is_outage() => Err(error),
            Err(error) => Err(self.attribute_error(error, task)),
        }
    }

    /// Attributes the error of a query to the query, or to the server if the server is out.
    fn attribute_error(&self, error: BackendError, task: &str) -> BackendError {
        let was_up = matches!(*self.health(), Health::Up(_));
        let cause = self.health().erred(&error.to_string(), task, Instant::now());
        match cause {
            None => error,
            Some(cause) => {
                if was_up {
                    self.log_outage(&cause);
                }
                BackendError::Broken { backend: self.to_string(), cause }
            }
        }
    }

    /// Sends a single query when its turn comes.
    async fn infer_alone(
        &self,
        call: Call<'_>,
        request: InferRequest,
    ) -> Result<InferResponse, BackendError> {
        let patience = self.queue_timeout();
        let Ok(_turn) = tokio::time::timeout(patience, self.calls.acquire()).await else {
            return Err(BackendError::Overloaded { backend: self.to_string(), waited: patience });
        };
        // The server may have failed while the query waited.
        self.admit(call)?.end();
        let answer = self.backend.infer(request);
        let answer = self.watch.queries(self.answer_within, answer, |answer| {
            u32::from(!matches!(answer, Err(error) if error.is_outage()))
        });
        self.unless_silent(answer.await)
    }

    /// Makes one call without queries if the server's health admits it, and records a failure or
    /// timeout.
    async fn call_within_limit<T>(
        &self,
        call: Call<'_>,
        answer: impl Future<Output = Result<T, BackendError>>,
    ) -> Result<T, BackendError> {
        let guard = self.admit(call)?;
        let answer = self.watch.answer(self.answer_within, answer).await;
        let answer = self.record_health(self.unless_silent(answer));
        guard.end();
        answer
    }

    fn admit<'a>(&'a self, call: Call<'a>) -> Result<CallGuard<'a>, BackendError> {
        let admitted = self.health().admit(call, Instant::now());
        let guard = admitted.map(|()| CallGuard { replica: self, call, has_ended: false });
        guard.map_err(|(cause, retry_in)| BackendError::OutOfService {
            backend: self.to_string(),
            cause,
            retry_in,
        })
    }

    /// Converts [`NoAnswer`], from a silent server, to a timeout.
    fn unless_silent<T>(
        &self,
        answer: Result<Result<T, BackendError>, NoAnswer>,
    ) -> Result<T, BackendError> {
        answer.unwrap_or_else(|NoAnswer| {
            Err(BackendError::TimedOut { backend: self.to_string(), limit: self.answer_within })
        })
    }

    fn record_health<T>(&self, answer: Result<T, BackendError>) -> Result<T, BackendError> {
        match &answer {
            Err(BackendError::TimedOut { .. }) => self.record_outage(Cause::NoAnswer),
            Err(error) if is_no_evidence(error) => {}
            Err(BackendError::Unreachable { trouble, .. }) => {
                let problem = trouble.to_string();
                self.record_outage(match trouble.fault.is_final() {
                    true => Cause::Misconfigured(problem),
                    false => Cause::Unreachable(problem),
                });
            }
            Err(error @ BackendError::TokenRejected { .. }) => {
                self.record_outage(Cause::TokenRejected(error.to_string()));
            }
            // A temporary refusal also shows that the server is up.
            Err(error) if error.is_outage() => self.answered(Answered::Other),
            _ => {}
        }
        answer
    }

    fn answered(&self, answered: Answered) {
        if self.health().answered(answered) {
            tracing::info!(backend = %self, "policy server recovered");
        }
    }

    fn record_outage(&self, cause: Cause) {
        let cause = cause.shortened();
        if self.health().failed(cause.clone(), Instant::now()) {
            self.log_outage(&cause);
        }
    }

    fn log_outage(&self, cause: &Cause) {
        tracing::warn!(backend = %self, "policy server out, retried with back-off: it {cause}");
    }

    fn health(&self) -> std::sync::MutexGuard<'_, Health> {
        self.health.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl fmt::Display for Replica {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.backend.fmt(f)
    }
}

/// Returns true if an error is no evidence about the server's health.
fn is_no_evidence(error: &BackendError) -> bool {
    matches!(
        error,
        BackendError::QueueFull { .. }
            | BackendError::Overloaded { .. }
            | BackendError::BatchLost
            | BackendError::OutOfService { .. }
    )
}

/// Returns the number of sessions that get their answers in time if all of them query at once, from
/// a server that takes `per_query` for each query; at least [`MIN_SESSIONS`].
fn capacity(patience: Duration, execute: u32, per_query: Duration) -> usize {
    let longest = patience.min(MAX_STEP_WAIT * execute.max(1));
    let sessions = longest.as_secs_f64() / per_query.as_secs_f64().max(1e-9);
    // A cast from float to integer saturates.
    (sessions as usize).max(MIN_SESSIONS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capacity_is_the_number_of_sessions_answered_in_time() {
        let sessions = |execute, millis| {
            let patience = Duration::from_secs(55);
            capacity(patience, execute, Duration::from_millis(millis))
        };
        assert_eq!(sessions(10, 400), 137);
        assert_eq!(sessions(10, 20), 2750);
        // A rollout that queries at every step must not wait 55 s at each step.
        assert_eq!(sessions(1, 400), 20);
        assert_eq!(sessions(1, 60_000), MIN_SESSIONS);
        assert!(sessions(1, 0) > 1_000_000);
    }
}
