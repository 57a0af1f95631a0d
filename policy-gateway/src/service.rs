//! `rollout.policy.v1` as the gateway offers it. Responsible for choosing the
//! route and for the version handshake; everything else is the route's.

use std::{fmt, sync::Arc};

use proto::policy::{
    DescribeRequest, DescribeResponse, InferBatchRequest, InferBatchResponse, InferRequest,
    InferResponse, InferResult, ResetRequest, ResetResponse, infer_result, policy_server::Policy,
};
use tokio::task::JoinSet;
use tonic::{Request, Response, Status};

use crate::{
    config::Config,
    route::{Route, RouteError},
};

/// Queries in one `InferBatch`.
pub const MAX_BATCH_QUERIES: usize = 64;

/// The policies of a gateway, by route.
pub struct Gateway {
    routes: Vec<Arc<Route>>,
}

impl Gateway {
    /// A gateway whose back-ends have not been asked anything yet.
    ///
    /// # Errors
    /// When an address is none.
    pub fn new(config: &Config) -> Result<Self, tonic::transport::Error> {
        let routes = config
            .routes()
            .iter()
            .map(|spec| Route::new(spec).map(Arc::new));
        Ok(Self {
            routes: routes.collect::<Result<_, _>>()?,
        })
    }

    fn route(&self, policy: &str) -> Result<&Arc<Route>, Status> {
        match (policy, self.routes.as_slice()) {
            ("", [only]) => Ok(only),
            ("", _) => Err(Status::invalid_argument(format!(
                "the request names no policy, and this gateway serves several: {}",
                Names(&self.routes)
            ))),
            _ => self
                .routes
                .iter()
                .find(|route| route.name().as_str() == policy)
                .ok_or_else(|| {
                    Status::not_found(format!(
                        "this gateway serves no policy {policy:?}; it serves {}",
                        Names(&self.routes)
                    ))
                }),
        }
    }
}

/// Writes the names of routes as a list.
struct Names<'a>(&'a [Arc<Route>]);

impl fmt::Display for Names<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, route) in self.0.iter().enumerate() {
            let separator = if at == 0 { "" } else { ", " };
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
        let DescribeRequest {
            protocol_version,
            policy,
        } = request.into_inner();
        if protocol_version != proto::PROTOCOL_VERSION {
            return Err(Status::failed_precondition(format!(
                "the caller speaks policy protocol version {protocol_version}, this gateway \
                 version {}; upgrade the older side",
                proto::PROTOCOL_VERSION
            )));
        }
        let described = self.route(&policy)?.describe().await?;
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

    async fn infer(
        &self,
        request: Request<InferRequest>,
    ) -> Result<Response<InferResponse>, Status> {
        let request = request.into_inner();
        Ok(Response::new(
            self.route(&request.policy)?.infer(request).await?,
        ))
    }

    /// Queries go to their back-ends side by side, each as if it had come
    /// alone. A back-end that is down fails the whole call, because the text
    /// of a single result could not say that nobody is to blame for it.
    async fn infer_batch(
        &self,
        request: Request<InferBatchRequest>,
    ) -> Result<Response<InferBatchResponse>, Status> {
        let queries = request.into_inner().queries;
        if queries.len() > MAX_BATCH_QUERIES {
            return Err(Status::invalid_argument(format!(
                "{} queries in one InferBatch; at most {MAX_BATCH_QUERIES} are taken",
                queries.len()
            )));
        }
        let mut results = vec![InferResult::default(); queries.len()];
        let mut under_way = JoinSet::new();
        for (at, query) in queries.into_iter().enumerate() {
            let route = Arc::clone(self.route(&query.policy)?);
            under_way.spawn(async move { (at, route.infer(query).await) });
        }
        while let Some(joined) = under_way.join_next().await {
            let (at, answer) = joined
                .map_err(|error| Status::internal(format!("a query of the batch: {error}")))?;
            results[at].result = Some(result(answer)?);
        }
        Ok(Response::new(InferBatchResponse { results }))
    }
}

fn result(answer: Result<InferResponse, RouteError>) -> Result<infer_result::Result, Status> {
    match answer {
        Ok(response) => Ok(infer_result::Result::Response(response)),
        Err(error) if error.is_outage() => Err(error.into()),
        Err(error) => Ok(infer_result::Result::Error(error.message())),
    }
}
