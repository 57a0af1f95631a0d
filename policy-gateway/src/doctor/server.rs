//! Client of a server under comparison or diagnosis: calls a route's back-end directly, so that
//! the gateway does not change its answers.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    },
    time::{Duration, Instant},
};

pub use benchmark::Action;
use policy_backends::{
    Backend, BackendError, BackendSpec, UnusableBackend, recording::RecordingError,
};
use proto::checks::{ActionFault, DescriptionFault};
use proto::policy::{DescribeResponse, InferRequest, InferResponse, Observation, ResetRequest};
use thiserror::Error;
use transport::{Access, chain};

use crate::doctor::situation::MissingInput;

/// Longest wait for an answer: models that compile at their first query take minutes.
pub(crate) const ANSWER_TIMEOUT: Duration = Duration::from_secs(600);

pub struct Server {
    pub(crate) url: String,
    pub described: DescribeResponse,
    backend: Arc<dyn Backend>,
    sessions: AtomicU32,
    /// Process id, which distinguishes this run's sessions from those of other runs.
    run: u32,
}

pub(crate) struct Episode<'a> {
    server: &'a Server,
    session: String,
    next_query: u32,
}

pub(crate) struct TimedAnswer {
    /// Answer of the server, unchecked.
    pub(crate) response: InferResponse,
    pub(crate) latency: Duration,
}

impl Server {
    /// Connects to the server of a route and reads its description.
    pub async fn connect(
        spec: &BackendSpec,
        access: &Access,
        suite: &str,
    ) -> Result<Self, ExaminationError> {
        let url = spec.to_string();
        let backend = spec.open(access)?;
        let described = in_time(&url, backend.describe(suite)).await?;
        if let Err(fault) = proto::checks::description(&described) {
            return Err(ExaminationError::Description { url, fault });
        }
        Ok(Self { url, described, backend, sessions: AtomicU32::new(0), run: std::process::id() })
    }

    pub(crate) fn lacks(&self, missing: MissingInput) -> ExaminationError {
        ExaminationError::MissingInput { url: self.url.clone(), missing }
    }

    pub(crate) async fn episode(
        &self,
        suite: &str,
        instruction: &str,
        seed: u64,
    ) -> Result<Episode<'_>, ExaminationError> {
        let number = self.sessions.fetch_add(1, Ordering::Relaxed);
        let session = format!("examination {}: {number}", self.run);
        let request = ResetRequest {
            policy: String::new(),
            session: session.clone(),
            suite: suite.to_owned(),
            instruction: instruction.to_owned(),
            seed,
        };
        in_time(&self.url, self.backend.reset(request)).await?;
        Ok(Episode { server: self, session, next_query: 0 })
    }

    /// Returns the actions of an answer after checking it.
    pub(crate) fn actions(&self, response: &InferResponse) -> Result<Vec<Action>, ActionFault> {
        let actions = proto::checks::actions(response, self.described.horizon)?;
        Ok(actions.iter().map(|action| action.map(f64::from)).collect())
    }
}

impl Episode<'_> {
    /// Sends the next query.
    pub(crate) async fn query(
        &mut self,
        observation: Observation,
    ) -> Result<TimedAnswer, ExaminationError> {
        let request = InferRequest {
            policy: String::new(),
            session: self.session.clone(),
            query_index: self.next_query,
            observation: Some(observation),
            under_way: None,
        };
        self.next_query += 1;
        let sent = Instant::now();
        let response = in_time(&self.server.url, self.server.backend.infer(request)).await?;
        Ok(TimedAnswer { response, latency: sent.elapsed() })
    }

    /// Sends the next query, and returns the checked actions of its answer.
    pub(crate) async fn actions(
        &mut self,
        observation: Observation,
    ) -> Result<Vec<Action>, ExaminationError> {
        let answer = self.query(observation).await?;
        let actions = self.server.actions(&answer.response);
        actions.map_err(|fault| ExaminationError::InvalidActions {
            url: self.server.url.clone(),
            fault,
        })
    }

    /// Ends the episode. Errors are ignored.
    pub(crate) async fn end(self) {
        let end = self.server.backend.end(&self.session);
        // A server may not implement `End`.
        let _ = tokio::time::timeout(Duration::from_secs(5), end).await;
    }
}

async fn in_time<T>(
    url: &str,
    answer: impl Future<Output = Result<T, BackendError>>,
) -> Result<T, ExaminationError> {
    let answer = tokio::time::timeout(ANSWER_TIMEOUT, answer).await;
    let answer = answer.map_err(|_| ExaminationError::NoAnswer { url: url.to_owned() })?;
    answer.map_err(|error| ExaminationError::Answer { url: url.to_owned(), problem: chain(&error) })
}

/// Reason why servers cannot be compared or diagnosed. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum ExaminationError {
    #[error(transparent)]
    Backend(#[from] UnusableBackend),
    #[error(transparent)]
    Recording(#[from] RecordingError),
    #[error("compare looks: give --look twice, with recordings in mujoco-3.3.2 and mujoco-3.3.3")]
    OneLook,
    #[error("get an answer from {url} within {} s", ANSWER_TIMEOUT.as_secs())]
    NoAnswer { url: String },
    #[error("get an answer from {url}: {problem}")]
    Answer { url: String, problem: String },
    #[error("use the description of {url}: {fault}; `policy-gateway check {url}` shows more")]
    Description { url: String, fault: DescriptionFault },
    #[error("use the answers of {url}: {fault}; `policy-gateway doctor {url}` counts such answers")]
    InvalidActions { url: String, fault: ActionFault },
    #[error(
        "query {url} with recorded observations: it needs {missing}, which the recordings lack; \
         record the queries of a policy that also needs this input, or leave --recorded out"
    )]
    MissingInput { url: String, missing: MissingInput },
}
