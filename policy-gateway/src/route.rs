//! Route of a gateway: its name, checkpoints and open sessions. A session stays with the pool in
//! which it was opened. A retry of the session's last query gets the same answer. A query whose
//! replica fails moves to another replica if the policy allows it. The memory of waiting queries is
//! limited.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

use policy_backends::sessions::{MAX_SESSION_BYTES, MAX_SESSIONS, SessionTable};
use policy_backends::{BackendError, UnusableBackend};
use proto::policy::{DescribeResponse, InferRequest, InferResponse, ResetRequest};

use self::checkpoints::Checkpoints;
use self::pool::{Opening, Pool};
use self::replica::Replica;
use crate::config::{RouteName, RouteSpec};
use crate::health::Call;
use crate::observation_budget::ObservationBudget;

mod checkpoints;
mod error;
pub mod pool;
pub mod replica;

pub use error::RouteError;

/// Time without a call after which a session no longer counts towards the capacity: the worker of
/// the session has ended, or simulates for long between queries.
const SESSION_IDLE: Duration = Duration::from_secs(120);
const RESET_POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Name, checkpoints and open sessions of a route.
pub struct Route {
    name: RouteName,
    checkpoints: RwLock<Arc<Checkpoints>>,
    sessions: Mutex<SessionTable<Arc<Session>>>,
    budget: Arc<ObservationBudget>,
    retired: AtomicBool,
}

struct Session {
    /// Pool in which the session was opened. If a reload replaces the pool, open sessions keep the
    /// old pool.
    pool: Arc<Pool>,
    /// Reset of the session; `None` for a session adopted after a restart of the gateway.
    reset: Option<ResetRequest>,
    last_call: Mutex<Instant>,
    /// Locked during a query, so that a retry that overtakes the first attempt waits for its
    /// answer.
    state: tokio::sync::Mutex<SessionState>,
}

struct SessionState {
    described: Arc<DescribeResponse>,
    open_on: Vec<Arc<Replica>>,
    last_answer: Option<Answer>,
}

struct Answer {
    query_index: u32,
    response: InferResponse,
}

impl Session {
    fn new(pool: Arc<Pool>, reset: Option<ResetRequest>, state: SessionState) -> Arc<Self> {
        Arc::new(Self { pool, reset, last_call: Mutex::new(Instant::now()), state: state.into() })
    }

    fn last_call(&self) -> std::sync::MutexGuard<'_, Instant> {
        self.last_call.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Route {
    /// Creates a route without calling its back-ends. The observations of its queries count in
    /// `budget`, which all routes of a gateway share.
    pub fn new(spec: &RouteSpec, budget: Arc<ObservationBudget>) -> Result<Self, UnusableBackend> {
        Ok(Self {
            name: spec.name.clone(),
            checkpoints: RwLock::new(Arc::new(Checkpoints::new(spec, &[])?)),
            sessions: Mutex::new(SessionTable::new(MAX_SESSIONS)),
            budget,
            retired: AtomicBool::new(false),
        })
    }

    /// Returns the route's name, as in the `policy` of requests.
    pub fn name(&self) -> &RouteName {
        &self.name
    }

    /// Returns true if new sessions are refused.
    pub fn is_retired(&self) -> bool {
        self.retired.load(Ordering::Relaxed)
    }

    /// Refuses new sessions from now on; open sessions continue.
    pub fn retire(&self) {
        self.retired.store(true, Ordering::Relaxed);
    }

    /// Applies `spec` to new sessions. Unchanged replicas keep their connections; the agreed
    /// descriptions are discarded. If this fails, the route is unchanged.
    pub fn reload(&self, spec: &RouteSpec) -> Result<(), UnusableBackend> {
        let existing = self.checkpoints().replicas();
        let new = Arc::new(Checkpoints::new(spec, &existing)?);
        *self.checkpoints.write().unwrap_or_else(PoisonError::into_inner) = new;
        self.retired.store(false, Ordering::Relaxed);
        Ok(())
    }

    pub async fn describe(&self, suite: &str) -> Result<Arc<DescribeResponse>, RouteError> {
        let pool = self.pool(suite)?;
        let mut tried = vec![];
        let mut failure = None;
        while let Some(replica) = pool.for_query("", &[], &tried) {
            match pool.describe(&replica, Call::Describe).await {
                Ok(described) => return Ok(described),
                Err(error) => {
                    let error = self.failed(&replica, error);
                    failure = Some(most_informative(failure, error));
                    tried.push(replica);
                }
            }
        }
        Err(self.no_answer(failure, ""))
    }

    /// Starts an episode. If the replicas are at capacity, waits for another session to end.
    pub async fn reset(&self, request: ResetRequest) -> Result<(), RouteError> {
        check_session(&request.session)?;
        if self.is_retired() {
            let route = self.name.clone();
            return Err(RouteError::Retired { route });
        }
        let pool = self.pool(&request.suite)?;
        let session = request.session.as_str();
        let _opening = self.reserve_capacity(&pool, session).await?;
        let mut tried = vec![];
        let mut failure = None;
        while let Some(replica) = pool.for_session(session, request.seed, &tried) {
            match open(&pool, &replica, &request).await {
                Ok(described) => {
                    let state =
                        SessionState { described, open_on: vec![replica], last_answer: None };
                    let open = Session::new(Arc::clone(&pool), Some(request.clone()), state);
                    self.sessions().open(session, open);
                    return Ok(());
                }
                Err(error) => {
                    let is_outage = error.is_outage();
                    let error = self.failed(&replica, error);
                    if !is_outage {
                        return Err(error);
                    }
                    failure = Some(most_informative(failure, error));
                    tried.push(replica);
                }
            }
        }
        Err(self.no_answer(failure, session))
    }

    /// Answers one observation. A retry of a session's last query gets the same answer.
    pub async fn infer(&self, request: InferRequest) -> Result<InferResponse, RouteError> {
        check_session(&request.session)?;
        let _reserved = self.budget.reserve(&request).ok_or(RouteError::Overloaded)?;
        let session = self.session(&request.session).await?;
        *session.last_call() = Instant::now();
        let mut state = session.state.lock().await;
        let query_index = request.query_index;
        if let Some(answer) =
            state.last_answer.as_ref().filter(|answer| answer.query_index == query_index)
        {
            return Ok(answer.response.clone());
        }
        let response = self.query_replicas(&session, &mut state, request).await?;
        state.last_answer = Some(Answer { query_index, response: response.clone() });
        Ok(response)
    }

    /// Closes a session, if it is open; after its query in flight, ends it at every replica where
    /// it is open.
    pub async fn end(&self, session: &str) {
        let Some(open) = self.sessions().close(session) else {
            return;
        };
        let replicas = std::mem::take(&mut open.state.lock().await.open_on);
        for replica in replicas {
            replica.end(session).await;
        }
    }

    /// Queries one replica after another, as far as the policy allows sessions to move.
    async fn query_replicas(
        &self,
        session: &Session,
        state: &mut SessionState,
        request: InferRequest,
    ) -> Result<InferResponse, RouteError> {
        let name = request.session.as_str();
        let task = session.reset.as_ref().map_or_else(
            || name.to_owned(),
            |reset| format!("{} {}", reset.suite, reset.instruction),
        );
        let may_move = session.reset.is_some() && !session.pool.pins(&state.described);
        let mut tried = vec![];
        let mut failure = None;
        loop {
            let replica = if may_move {
                session.pool.for_query(name, &state.open_on, &tried)
            } else {
                state.open_on.first().filter(|_| tried.is_empty()).cloned()
            };
            let Some(replica) = replica else {
                return Err(self.no_answer(failure, name));
            };
            let error = match query_replica(session, state, &replica, &request, &task).await {
                Ok(response) => return Ok(response),
                Err(error) => error,
            };
            let is_outage = error.is_outage();
            // After a timeout, the caller no longer waits for another replica.
            let is_late = matches!(error, BackendError::TimedOut { .. });
            let error = self.failed_query(request.query_index, &replica, error);
            if !is_outage || is_late {
                return Err(error);
            }
            if may_move {
                state.open_on.retain(|open| !Arc::ptr_eq(open, &replica));
            }
            failure = Some(most_informative(failure, error));
            tried.push(replica);
        }
    }

    /// Returns an open session. After a restart of the gateway, the back-end may still hold a
    /// session that the gateway no longer knows; if the route has a single replica, the session is
    /// adopted from it.
    async fn session(&self, name: &str) -> Result<Arc<Session>, RouteError> {
        if let Some(open) = self.sessions().get(name) {
            return Ok(Arc::clone(open));
        }
        let Some((pool, replica)) = self.checkpoints().only() else {
            return Err(self.no_answer(None, name));
        };
        let described = pool
            .describe(&replica, Call::InSession(name))
            .await
            .map_err(|error| self.failed(&replica, error))?;
        let state = SessionState { described, open_on: vec![replica], last_answer: None };
        let adopted = Session::new(pool, None, state);
        let mut sessions = self.sessions();
        // Another query of the session may have adopted the session meanwhile.
        Ok(match sessions.get(name) {
            Some(open) => Arc::clone(open),
            None => Arc::clone(sessions.open(name, adopted)),
        })
    }

    /// Waits until the replicas have capacity for one more session. A session that is already open
    /// needs no further capacity.
    async fn reserve_capacity(
        &self,
        pool: &Arc<Pool>,
        session: &str,
    ) -> Result<Option<Opening>, RouteError> {
        let until = Instant::now() + pool.reset_timeout();
        loop {
            {
                let mut sessions = self.sessions();
                if sessions.get(session).is_some() {
                    return Ok(None);
                }
                let now = Instant::now();
                let is_counted = |session: &&Arc<Session>| {
                    session.pool.shares_with(pool)
                        && now.duration_since(*session.last_call()) < SESSION_IDLE
                };
                let open = sessions.values().filter(is_counted).count();
                if let Some(opening) = pool.reserve_session(open) {
                    return Ok(Some(opening));
                }
                if now >= until {
                    return Err(RouteError::Full {
                        route: self.name.clone(),
                        sessions: open,
                        per_query: pool.per_query().unwrap_or_default(),
                    });
                }
            }
            tokio::time::sleep(RESET_POLL_INTERVAL).await;
        }
    }

    fn pool(&self, suite: &str) -> Result<Arc<Pool>, RouteError> {
        let checkpoints = self.checkpoints();
        checkpoints.pool(suite).cloned().ok_or_else(|| RouteError::Suite {
            route: self.name.clone(),
            suite: suite.to_owned(),
            known: checkpoints.suites(),
        })
    }

    fn checkpoints(&self) -> Arc<Checkpoints> {
        let checkpoints = self.checkpoints.read();
        Arc::clone(&checkpoints.unwrap_or_else(PoisonError::into_inner))
    }

    fn sessions(&self) -> std::sync::MutexGuard<'_, SessionTable<Arc<Session>>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn failed(&self, replica: &Replica, source: BackendError) -> RouteError {
        RouteError::Replica {
            route: self.name.clone(),
            replica: replica.to_string(),
            source: source.into(),
        }
    }

    fn failed_query(
        &self,
        query_index: u32,
        replica: &Replica,
        source: BackendError,
    ) -> RouteError {
        match source {
            BackendError::InvalidActions { fault } => RouteError::Action {
                route: self.name.clone(),
                replica: replica.to_string(),
                query_index,
                source: fault,
            },
            source => self.failed(replica, source),
        }
    }

    fn no_answer(&self, failure: Option<RouteError>, session: &str) -> RouteError {
        failure.unwrap_or_else(|| RouteError::SessionLost {
            route: self.name.clone(),
            session: session.to_owned(),
        })
    }
}

/// Opens a session at a replica, after checking its description.
async fn open(
    pool: &Pool,
    replica: &Replica,
    request: &ResetRequest,
) -> Result<Arc<DescribeResponse>, BackendError> {
    let described = pool.describe(replica, Call::InSession(&request.session)).await?;
    replica.reset(request.clone()).await?;
    Ok(described)
}

/// Queries one replica, after opening the session there if necessary.
async fn query_replica(
    session: &Session,
    state: &mut SessionState,
    replica: &Arc<Replica>,
    request: &InferRequest,
    task: &str,
) -> Result<InferResponse, BackendError> {
    if !state.open_on.iter().any(|open| Arc::ptr_eq(open, replica))
        && let Some(reset) = &session.reset
    {
        open(&session.pool, replica, reset).await?;
        state.open_on.push(Arc::clone(replica));
    }
    let horizon = state.described.horizon;
    replica.infer(request.clone(), horizon, task).await
}

/// Returns the failure to report for a call that failed at several replicas: the earlier failure,
/// unless there is none or its replica was already out of service.
fn most_informative(earlier: Option<RouteError>, new: RouteError) -> RouteError {
    let is_out_of_service = |error: &RouteError| {
        matches!(error, RouteError::Replica { source, .. }
            if matches!(**source, BackendError::OutOfService { .. }))
    };
    match earlier {
        Some(earlier) if !is_out_of_service(&earlier) => earlier,
        _ => new,
    }
}

fn check_session(session: &str) -> Result<(), RouteError> {
    if (1..=MAX_SESSION_BYTES).contains(&session.len()) {
        Ok(())
    } else {
        Err(RouteError::Session { bytes: session.len() })
    }
}
