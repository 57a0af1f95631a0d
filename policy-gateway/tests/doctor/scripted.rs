//! Policy servers on free loopback ports, with answers that the test defines, and the points of the
//! policy protocol on which a server fails. The gateway's tests include this file, too.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};

use benchmark::Suite;
use policy_gateway::doctor::check::{Point, check};
use policy_gateway::doctor::probe::Target;
use policy_gateway::doctor::verdict::Finding;
use proto::policy::policy_client::PolicyClient;
use proto::policy::policy_server::{Policy, PolicyServer};
use proto::policy::{
    DescribeRequest, DescribeResponse, EndRequest, EndResponse, InferBatchRequest,
    InferBatchResponse, InferRequest, InferResponse, ResetRequest, ResetResponse,
};
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use tonic::transport::server::TcpIncoming;
use tonic::transport::{Channel, Server};
use tonic::{Request, Response, Status};

pub(crate) struct Running {
    pub(crate) address: SocketAddr,
    stop: oneshot::Sender<()>,
    task: JoinSet<()>,
}

impl Running {
    pub(crate) fn new(address: SocketAddr, stop: oneshot::Sender<()>, task: JoinSet<()>) -> Self {
        Self { address, stop, task }
    }

    pub(crate) async fn stop(mut self) {
        self.stop.send(()).expect("the server still runs");
        let ended = self.task.join_next().await.expect("one task");
        ended.expect("the server stops in order");
    }

    pub(crate) async fn client(&self) -> PolicyClient<Channel> {
        client(self.address).await
    }
}

/// Starts a policy server that is not a gateway, on a free port.
pub(crate) async fn serve(policy: impl Policy) -> Running {
    serve_any(AnyPolicy(Box::new(policy))).await
}

/// A policy of any type, so that the server is compiled only once.
struct AnyPolicy(Box<dyn Policy>);

#[tonic::async_trait]
impl Policy for AnyPolicy {
    async fn describe(
        &self,
        request: Request<DescribeRequest>,
    ) -> Result<Response<DescribeResponse>, Status> {
        self.0.describe(request).await
    }

    async fn reset(
        &self,
        request: Request<ResetRequest>,
    ) -> Result<Response<ResetResponse>, Status> {
        self.0.reset(request).await
    }

    async fn infer(
        &self,
        request: Request<InferRequest>,
    ) -> Result<Response<InferResponse>, Status> {
        self.0.infer(request).await
    }

    async fn infer_batch(
        &self,
        request: Request<InferBatchRequest>,
    ) -> Result<Response<InferBatchResponse>, Status> {
        self.0.infer_batch(request).await
    }

    async fn end(&self, request: Request<EndRequest>) -> Result<Response<EndResponse>, Status> {
        self.0.end(request).await
    }
}

async fn serve_any(policy: AnyPolicy) -> Running {
    let (health, health_service) = tonic_health::server::health_reporter();
    health.set_serving::<PolicyServer<AnyPolicy>>().await;
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("a bound address");
    let (stop, stopped) = oneshot::channel();
    let mut task = JoinSet::new();
    task.spawn(async move {
        Server::builder()
            .add_service(health_service)
            .add_service(PolicyServer::new(policy))
            .serve_with_incoming_shutdown(TcpIncoming::from(listener), async {
                stopped.await.unwrap_or(());
            })
            .await
            .expect("the server serves");
    });
    Running::new(address, stop, task)
}

pub(crate) async fn client(address: SocketAddr) -> PolicyClient<Channel> {
    PolicyClient::connect(format!("http://{address}")).await.expect("a server at the address")
}

/// Returns a description that any gateway accepts.
pub(crate) fn description(name: &str, horizon: u32) -> DescribeResponse {
    DescribeResponse {
        protocol_version: proto::PROTOCOL_VERSION,
        name: name.to_owned(),
        horizon,
        execute: 1,
        ..DescribeResponse::default()
    }
}

pub(crate) fn chunk(actions: &[f32], action_width: u32) -> InferResponse {
    InferResponse { actions: actions.to_vec(), action_width }
}

pub(crate) struct Query {
    /// Seed of the session's Reset, if there was one.
    pub(crate) seed: Option<u64>,
    pub(crate) query_index: u32,
    /// Number of earlier queries, over all sessions.
    pub(crate) earlier_queries: u32,
}

/// A policy with a given description, whose answers a function computes. It does not check the
/// protocol itself.
pub(crate) struct Scripted {
    described: Box<dyn Fn() -> DescribeResponse + Send + Sync>,
    answer: Box<dyn Fn(Query) -> Result<InferResponse, Status> + Send + Sync>,
    seeds: Mutex<HashMap<String, u64>>,
    queries: AtomicU32,
}

impl Scripted {
    pub(crate) fn new(
        described: DescribeResponse,
        answer: impl Fn(Query) -> Result<InferResponse, Status> + Send + Sync + 'static,
    ) -> Self {
        Self {
            described: Box::new(move || described.clone()),
            answer: Box::new(answer),
            seeds: Mutex::default(),
            queries: AtomicU32::new(0),
        }
    }

    pub(crate) fn describing(
        mut self,
        described: impl Fn() -> DescribeResponse + Send + Sync + 'static,
    ) -> Self {
        self.described = Box::new(described);
        self
    }
}

#[tonic::async_trait]
impl Policy for Scripted {
    async fn describe(
        &self,
        _: Request<DescribeRequest>,
    ) -> Result<Response<DescribeResponse>, Status> {
        Ok(Response::new((self.described)()))
    }

    async fn reset(
        &self,
        request: Request<ResetRequest>,
    ) -> Result<Response<ResetResponse>, Status> {
        let ResetRequest { session, seed, .. } = request.into_inner();
        self.seeds.lock().expect("no test panics here").insert(session, seed);
        Ok(Response::new(ResetResponse {}))
    }

    async fn infer(
        &self,
        request: Request<InferRequest>,
    ) -> Result<Response<InferResponse>, Status> {
        let InferRequest { session, query_index, .. } = request.into_inner();
        let seed = self.seeds.lock().expect("no test panics here").get(&session).copied();
        let earlier_queries = self.queries.fetch_add(1, Ordering::SeqCst);
        (self.answer)(Query { seed, query_index, earlier_queries }).map(Response::new)
    }

    async fn infer_batch(
        &self,
        _: Request<InferBatchRequest>,
    ) -> Result<Response<InferBatchResponse>, Status> {
        Err(Status::unimplemented("the policy takes no batches"))
    }
}

/// Answers like a well-behaved policy: a function of seed and query alone.
pub(crate) fn proper(query: &Query) -> Result<InferResponse, Status> {
    let seed = query.seed.ok_or_else(|| Status::unavailable("the session is not open"))?;
    Ok(chunk(&[(seed as f32 + query.query_index as f32 / 10.0) / 100.0; 7], 7))
}

pub(crate) fn stochastic() -> DescribeResponse {
    DescribeResponse { stochastic: true, ..description("p", 1) }
}

/// Checks a server, given by its address, with `/POLICY` if it has several policies.
pub(crate) async fn findings(address: &str) -> Vec<Finding> {
    let mut findings = vec![];
    let conforms = check(&target(address), &mut |finding| findings.push(finding.clone())).await;
    let failed = |finding: &Finding| finding.verdict.has_failed();
    assert_eq!(conforms.expect("a server"), !findings.iter().any(failed));
    findings
}

pub(crate) fn target(address: &str) -> Target {
    let (host, policy) = address.split_once('/').unwrap_or((address, ""));
    Target {
        url: format!("grpc://{host}"),
        shown: "the server".to_owned(),
        policy: policy.to_owned(),
        suite: Suite::Goal,
        access: transport::Access::none(),
    }
}

pub(crate) async fn failures(address: &str) -> Vec<Point> {
    let mut findings = findings(address).await;
    findings.retain(|finding| finding.verdict.has_failed());
    findings.into_iter().map(|finding| finding.point).collect()
}
