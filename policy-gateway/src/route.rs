//! One route: a name, the back-end that answers for it, and what the gateway
//! adds, which is the same for all back-ends: retries of a session's last
//! query get the same answer, answers are checked, and queries in flight are
//! bounded.

use std::{
    error::Error as _,
    sync::{Arc, Mutex, PoisonError},
};

use proto::policy::{DescribeResponse, InferRequest, InferResponse, ResetRequest};
use thiserror::Error;
use tokio::sync::{RwLock, Semaphore};
use tonic::{Code, Status};

use crate::{
    backend::{Backend, BackendError, builtin::BuiltinBackend, grpc::GrpcBackend},
    check::{self, ActionFault, DescriptionFault},
    config::{BackendSpec, RouteName, RouteSpec},
    sessions::{MAX_SESSION_BYTES, MAX_SESSIONS, SessionTable},
};

/// Queries of one route that may wait for their answers at once; more are
/// refused, so that a stalled server does not fill the memory with frames.
pub const MAX_QUERIES_IN_FLIGHT: usize = 1024;

/// A name and what answers for it.
pub struct Route {
    name: RouteName,
    backend: Box<dyn Backend>,
    /// What the policy last said of itself.
    described: RwLock<Option<Arc<DescribeResponse>>>,
    sessions: Mutex<SessionTable<Session>>,
    in_flight: Semaphore,
}

/// The last answer of a session. Locked while a query is under way, so that a
/// retry which overtakes its first attempt waits for that one's answer.
type Session = Arc<tokio::sync::Mutex<Option<Answer>>>;

struct Answer {
    query_index: u32,
    response: InferResponse,
}

impl Route {
    /// A route whose back-end has not been asked anything yet.
    ///
    /// # Errors
    /// When the back-end's address is none.
    pub fn new(spec: &RouteSpec) -> Result<Self, tonic::transport::Error> {
        let backend: Box<dyn Backend> = match &spec.backend {
            BackendSpec::Builtin(builtin) => Box::new(BuiltinBackend::new(*builtin)),
            BackendSpec::Grpc(address) => Box::new(GrpcBackend::new(address.clone())?),
        };
        Ok(Self {
            name: spec.name.clone(),
            backend,
            described: RwLock::default(),
            sessions: Mutex::new(SessionTable::new(MAX_SESSIONS)),
            in_flight: Semaphore::new(MAX_QUERIES_IN_FLIGHT),
        })
    }

    /// What a request's `policy` says.
    pub fn name(&self) -> &RouteName {
        &self.name
    }

    /// Asks the back-end what its policy is.
    ///
    /// # Errors
    /// When it does not answer, or its answer cannot be true.
    pub async fn describe(&self) -> Result<Arc<DescribeResponse>, RouteError> {
        let described = self
            .backend
            .describe()
            .await
            .map_err(|source| self.failed("", source))?;
        check::description(&described).map_err(|source| RouteError::Description {
            policy: described.name.clone(),
            route: self.name.clone(),
            backend: self.backend.to_string(),
            source,
        })?;
        let described = Arc::new(described);
        *self.described.write().await = Some(Arc::clone(&described));
        Ok(described)
    }

    /// Starts an episode.
    ///
    /// # Errors
    /// When the session has no usable name or the back-end does not answer.
    pub async fn reset(&self, request: ResetRequest) -> Result<(), RouteError> {
        check_session(&request.session)?;
        let session = request.session.clone();
        self.backend
            .reset(request)
            .await
            .map_err(|source| self.failed(&format!(" on Reset of session {session:?}"), source))?;
        self.sessions().open(&session, Session::default());
        Ok(())
    }

    /// Answers one observation; a retry of a session's last query gets the
    /// answer that was given.
    ///
    /// # Errors
    /// When the back-end does not answer, or its answer is no chunk of actions
    /// (see [`check::actions`]).
    pub async fn infer(&self, request: InferRequest) -> Result<InferResponse, RouteError> {
        check_session(&request.session)?;
        let _in_flight = self
            .in_flight
            .try_acquire()
            .map_err(|_| RouteError::Overloaded {
                route: self.name.clone(),
            })?;
        let InferRequest {
            session,
            query_index,
            ..
        } = &request;
        let (session, query_index) = (session.clone(), *query_index);
        let last = self.session(&session);
        let mut last = last.lock().await;
        if let Some(answer) = last
            .as_ref()
            .filter(|answer| answer.query_index == query_index)
        {
            return Ok(answer.response.clone());
        }
        let known = self.described.read().await.clone();
        let described = match known {
            Some(described) => described,
            None => self.describe().await?,
        };
        let response = self.backend.infer(request).await.map_err(|source| {
            self.failed(
                &format!(" on session {session:?}, query {query_index}"),
                source,
            )
        })?;
        check::actions(&response, described.horizon).map_err(|source| RouteError::Action {
            policy: described.name.clone(),
            route: self.name.clone(),
            session,
            query_index,
            source,
        })?;
        *last = Some(Answer {
            query_index,
            response: response.clone(),
        });
        Ok(response)
    }

    /// The session's last answer. A gateway that restarted does not know a
    /// session that its back-end may still hold, so an unknown one is opened
    /// and the back-end judges.
    fn session(&self, session: &str) -> Session {
        let mut sessions = self.sessions();
        match sessions.get(session) {
            Some(open) => Arc::clone(open),
            None => Arc::clone(sessions.open(session, Session::default())),
        }
    }

    fn sessions(&self) -> std::sync::MutexGuard<'_, SessionTable<Session>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn failed(&self, at: &str, source: BackendError) -> RouteError {
        RouteError::Backend {
            route: self.name.clone(),
            backend: self.backend.to_string(),
            at: at.to_owned(),
            source: source.into(),
        }
    }
}

fn check_session(session: &str) -> Result<(), RouteError> {
    if (1..=MAX_SESSION_BYTES).contains(&session.len()) {
        Ok(())
    } else {
        Err(RouteError::Session {
            bytes: session.len(),
        })
    }
}

/// Why a route did not answer.
#[derive(Debug, Error)]
pub enum RouteError {
    /// The back-end did not.
    #[error("route {route} ({backend}){at}")]
    Backend {
        /// Name of the route.
        route: RouteName,
        /// Its back-end as configured.
        backend: String,
        /// " on session …", as far as known.
        at: String,
        /// Why not.
        #[source]
        source: Box<BackendError>,
    },
    /// The policy answered nonsense.
    #[error("policy {policy:?} (route {route}), session {session:?}, query {query_index}")]
    Action {
        /// The policy's own name.
        policy: String,
        /// Name of the route.
        route: RouteName,
        /// The episode.
        session: String,
        /// Which of its queries.
        query_index: u32,
        /// What is wrong.
        #[source]
        source: ActionFault,
    },
    /// The policy describes itself as nothing that can be run.
    #[error("policy {policy:?} (route {route}, {backend}) describes itself wrongly")]
    Description {
        /// The policy's own name.
        policy: String,
        /// Name of the route.
        route: RouteName,
        /// Its back-end as configured.
        backend: String,
        /// What is wrong.
        #[source]
        source: DescriptionFault,
    },
    /// A session without a name, or with a book for one.
    #[error("a session's name has 1 to {MAX_SESSION_BYTES} bytes, this one {bytes}")]
    Session {
        /// Its length.
        bytes: usize,
    },
    /// Too many queries wait already.
    #[error("route {route} has {MAX_QUERIES_IN_FLIGHT} queries under way; try again later")]
    Overloaded {
        /// Name of the route.
        route: RouteName,
    },
}

impl RouteError {
    /// The gRPC code that says it to a worker: see [`BackendError`].
    pub fn code(&self) -> Code {
        match self {
            Self::Backend { source, .. } => source.code(),
            Self::Action { .. } | Self::Description { .. } => Code::Internal,
            Self::Session { .. } => Code::InvalidArgument,
            Self::Overloaded { .. } => Code::ResourceExhausted,
        }
    }

    /// The error and its cause in one line, for the wire.
    pub fn message(&self) -> String {
        match self.source() {
            Some(cause) => format!("{self}: {cause}"),
            None => self.to_string(),
        }
    }

    /// Whether the infrastructure failed, not this query.
    pub fn is_outage(&self) -> bool {
        matches!(
            self.code(),
            Code::Unavailable | Code::DeadlineExceeded | Code::ResourceExhausted
        )
    }
}

impl From<RouteError> for Status {
    fn from(error: RouteError) -> Self {
        Self::new(error.code(), error.message())
    }
}
