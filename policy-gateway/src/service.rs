//! The gateway's implementation of `rollout.policy.v1`: chooses the route and checks the protocol
//! version; the route answers the call.

use std::fmt;
use std::sync::{Arc, PoisonError, RwLock};

use policy_backends::UnusableBackend;
use policy_backends::description::MAX_BATCH_QUERIES;
use proto::policy::policy_server::Policy;
use proto::policy::{
    DescribeRequest, DescribeResponse, EndRequest, EndResponse, InferBatchRequest,
    InferBatchResponse, InferRequest, InferResponse, InferResult, ResetRequest, ResetResponse,
    infer_result,
};
use tokio::task::JoinSet;
use tonic::{Request, Response, Status};

use crate::config::{Config, RouteSpec};
use crate::observation_budget::ObservationBudget;
use crate::route::{Route, RouteError};

/// Largest number of routes that are kept for their open sessions after they were removed from the
/// configuration. If there are more, the earliest configured of them are dropped.
pub const MAX_RETIRED_ROUTES: usize = 64;

/// Policies of a gateway, by route. Clones share their state.
#[derive(Clone)]
pub struct Gateway {
    routes: Arc<RwLock<Vec<Arc<Route>>>>,
    budget: Arc<ObservationBudget>,
}

impl Gateway {
    /// Creates a gateway without calling its back-ends.
    pub fn new(config: &Config) -> Result<Self, UnusableBackend> {
        let budget = Arc::<ObservationBudget>::default();
        let routes =
            config.routes().iter().map(|spec| Route::new(spec, Arc::clone(&budget)).map(Arc::new));
        let routes = routes.collect::<Result<Vec<_>, _>>()?;
        Ok(Self { routes: Arc::new(RwLock::new(routes)), budget })
    }

    /// Applies `config` to new sessions; open sessions keep their replicas. If this fails, earlier
    /// routes may have changed already.
    pub fn reload(&self, config: &Config) -> Result<(), UnusableBackend> {
        let mut routes = self.routes.write().unwrap_or_else(PoisonError::into_inner);
        for spec in config.routes() {
            match routes.iter().find(|route| route.name() == &spec.name) {
                Some(route) => route.reload(spec)?,
                None => routes.push(Arc::new(Route::new(spec, Arc::clone(&self.budget))?)),
            }
        }
        for route in routes.iter() {
            let is_configured = |spec: &RouteSpec| &spec.name == route.name();
            if !config.routes().iter().any(is_configured) {
                route.retire();
            }
        }
        let mut surplus = routes.iter().filter(|route| route.is_retired()).count();
        routes.retain(|route| {
            let is_dropped = route.is_retired() && surplus > MAX_RETIRED_ROUTES;
            surplus -= usize::from(is_dropped);
            !is_dropped
        });
        Ok(())
    }

    /// Returns the route of a policy; if none is named, the only route that takes new sessions.
    fn route(&self, policy: &str) -> Result<Arc<Route>, Status> {
        let routes = self.routes.read().unwrap_or_else(PoisonError::into_inner);
        if !policy.is_empty() {
            let named = routes.iter().find(|route| route.name().as_str() == policy);
            return named.cloned().ok_or_else(|| {
                Status::not_found(format!(
                    "this gateway serves no policy {policy:?}; it serves {}",
                    Names(&routes)
                ))
            });
        }
        let mut serving = routes.iter().filter(|route| !route.is_retired());
        match (serving.next(), serving.next()) {
            (Some(only), None) => Ok(Arc::clone(only)),
            _ => Err(Status::invalid_argument(format!(
                "this gateway serves several policies ({}), and the request names none of them: \
                 choose one, with `--policy NAME` or at the end of the address, \
                 `grpc://HOST:PORT/NAME`",
                Names(&routes)
            ))),
        }
    }
}

/// Formats the names of routes as a list.
struct Names<'a>(&'a [Arc<Route>]);

impl fmt::Display for Names<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let serving = self.0.iter().filter(|route| !route.is_retired());
        for (index, route) in serving.enumerate() {
            let separator = if index == 0 { "" } else { ", " };
            write!(f, "{separator}{}", route.name())?;
        }
        Ok(())
    }
}

#[tonic::async_trait]
impl Policy for Gateway {
    async fn describe(
        &self,
        request: Request<DescribeRequest>,
    ) -> Result<Response<DescribeResponse>, Status> {
        let DescribeRequest { protocol_version, policy, suite } = request.into_inner();
        if protocol_version != proto::PROTOCOL_VERSION {
            return Err(Status::failed_precondition(format!(
                "the caller speaks policy protocol version {protocol_version}, this gateway \
                 version {}; upgrade the older side",
                proto::PROTOCOL_VERSION
            )));
        }
        let described = self.route(&policy)?.describe(&suite).await?;
        Ok(Response::new(DescribeResponse::clone(&described)))
    }

    async fn reset(
        &self,
        request: Request<ResetRequest>,
    ) -> Result<Response<ResetResponse>, Status> {
        let request = request.into_inner();
        self.route(&request.policy)?.reset(request).await?;
        Ok(Response::new(ResetResponse {}))
    }

    async fn end(&self, request: Request<EndRequest>) -> Result<Response<EndResponse>, Status> {
        let request = request.into_inner();
        self.route(&request.policy)?.end(&request.session).await;
        Ok(Response::new(EndResponse {}))
    }

    async fn infer(
        &self,
        request: Request<InferRequest>,
    ) -> Result<Response<InferResponse>, Status> {
        let request = request.into_inner();
        Ok(Response::new(self.route(&request.policy)?.infer(request).await?))
    }

    /// Queries are sent to their back-ends concurrently, each as if it had been sent alone. If a
    /// back-end is down, the whole call fails: a single result has only an error text, without the
    /// status code that tells a worker not to charge the failure to the rollout.
    async fn infer_batch(
        &self,
        request: Request<InferBatchRequest>,
    ) -> Result<Response<InferBatchResponse>, Status> {
        let queries = request.into_inner().queries;
        if queries.len() > MAX_BATCH_QUERIES {
            return Err(Status::invalid_argument(format!(
                "{} queries in one InferBatch; at most {MAX_BATCH_QUERIES} are accepted",
                queries.len()
            )));
        }
        let mut results = vec![InferResult::default(); queries.len()];
        let mut in_flight = JoinSet::new();
        for (index, query) in queries.into_iter().enumerate() {
            let route = self.route(&query.policy)?;
            in_flight.spawn(async move { (index, route.infer(query).await) });
        }
        while let Some(joined) = in_flight.join_next().await {
            let (index, answer) = joined.map_err(|error| {
                Status::internal(format!("a query of the batch failed: {error}"))
            })?;
            results[index].result = Some(result(answer)?);
        }
        Ok(Response::new(InferBatchResponse { results }))
    }
}

fn result(answer: Result<InferResponse, RouteError>) -> Result<infer_result::Result, Status> {
    match answer {
        Ok(response) => Ok(infer_result::Result::Response(response)),
        Err(error) if error.is_outage() => Err(error.into()),
        Err(error) => Ok(infer_result::Result::Error(error.one_line())),
    }
}
