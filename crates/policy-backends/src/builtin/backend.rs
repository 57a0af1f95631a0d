//! Back-end of the policies that run inside the gateway: one instance per session, queried in
//! order if the policy is stateful.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use proto::checks::ACTION_WIDTH;
use proto::policy::{DescribeResponse, InferRequest, InferResponse, ResetRequest};
use tokio::task::JoinSet;

use super::{BuiltinPolicy, Policy};
use crate::backend::{Backend, BackendError};
use crate::sessions::{MAX_SESSIONS, SessionTable};

pub(crate) struct BuiltinBackend {
    name: String,
    policy: Policy,
    sessions: Mutex<SessionTable<Arc<Mutex<Instance>>>>,
}

struct Instance {
    policy: Box<dyn BuiltinPolicy>,
    next_query: u32,
}

impl Instance {
    fn answer(
        &mut self,
        is_stateful: bool,
        request: InferRequest,
    ) -> Result<InferResponse, BackendError> {
        if is_stateful && request.query_index != self.next_query {
            return Err(BackendError::OutOfOrder { expected: self.next_query });
        }
        let observation = request.observation.unwrap_or_default();
        let actions = self
            .policy
            .infer(request.query_index, &observation)
            .map_err(|message| BackendError::Policy { message })?;
        self.next_query = request.query_index.saturating_add(1);
        Ok(InferResponse { actions: actions.into_flattened(), action_width: ACTION_WIDTH as u32 })
    }
}

/// Returns the error of a policy that panicked; `when` is a phrase such as "at this query".
fn panicked(when: &str) -> BackendError {
    BackendError::Policy { message: format!("it panicked {when} of this session") }
}

impl BuiltinBackend {
    pub(crate) fn new(name: String, policy: Policy) -> Self {
        Self { name, policy, sessions: Mutex::new(SessionTable::new(MAX_SESSIONS)) }
    }

    fn sessions(&self) -> MutexGuard<'_, SessionTable<Arc<Mutex<Instance>>>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn instance(&self, session: &str) -> Option<Arc<Mutex<Instance>>> {
        self.sessions().get(session).cloned()
    }
}

#[tonic::async_trait]
impl Backend for BuiltinBackend {
    async fn describe(&self, _suite: &str) -> Result<DescribeResponse, BackendError> {
        Ok(self.policy.described.clone())
    }

    async fn reset(&self, request: ResetRequest) -> Result<(), BackendError> {
        let instance = Instance { policy: (self.policy.start)(&request), next_query: 0 };
        let instance = Arc::new(Mutex::new(instance));
        self.sessions().open(&request.session, instance);
        Ok(())
    }

    async fn end(&self, session: &str) {
        self.sessions().close(session);
    }

    async fn infer(&self, request: InferRequest) -> Result<InferResponse, BackendError> {
        let instance = self.instance(&request.session).ok_or(BackendError::SessionLost)?;
        let stateful = self.policy.described.stateful;
        // The set aborts its task when dropped, so that a query without a caller never starts.
        let mut answering = JoinSet::new();
        answering.spawn_blocking(move || {
            // Only a panic inside the policy poisons the lock; the instance's state is then
            // unreliable.
            let mut instance = instance.lock().map_err(|_| panicked("at an earlier query"))?;
            instance.answer(stateful, request)
        });
        let answered = answering.join_next().await;
        answered.and_then(Result::ok).unwrap_or_else(|| Err(panicked("at this query")))
    }
}

impl fmt::Display for BuiltinBackend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.name.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builtin::Builtin;

    #[tokio::test]
    async fn an_ended_session_is_not_kept() {
        let backend = BuiltinBackend::new("noop".to_owned(), Builtin::Noop.policy());
        let request = ResetRequest { session: "s".to_owned(), ..ResetRequest::default() };
        backend.reset(request).await.expect("a session");
        assert!(backend.instance("s").is_some());
        backend.end("s").await;
        assert!(backend.instance("s").is_none());
    }
}
