//! Servers on free loopback ports, their clients, and a policy whose answers are defined by the
//! test.

use std::{
    collections::HashMap,
    net::SocketAddr,
    sync::{
        Mutex,
        atomic::{AtomicU32, Ordering},
    },
};

use policy_gateway::{
    config::{Config, RouteSpec},
    service::Gateway,
};
use proto::policy::{
    DescribeRequest, DescribeResponse, EndRequest, EndResponse, InferBatchRequest,
    InferBatchResponse, InferRequest, InferResponse, Observation, ResetRequest, ResetResponse,
    policy_client::PolicyClient,
    policy_server::{Policy, PolicyServer},
};
use tokio::{net::TcpListener, sync::oneshot, task::JoinSet};
use tonic::{
    Request, Response, Status,
    transport::{Channel, Server, server::TcpIncoming},
};

/// A server in this process, which can be stopped to free its port.
pub(crate) struct Running {
    pub(crate) address: SocketAddr,
    stop: oneshot::Sender<()>,
    task: JoinSet<()>,
}

impl Running {
    pub(crate) async fn stop(mut self) {
        self.stop.send(()).expect("the server still runs");
        let ended = self.task.join_next().await.expect("one task");
        ended.expect("the server stops in order");
    }

    pub(crate) async fn client(&self) -> PolicyClient<Channel> {
        client(self.address).await
    }
}

/// Starts a gateway with these routes on a free port.
pub(crate) async fn gateway(routes: &[&str]) -> Running {
    gateway_at("127.0.0.1:0".parse().expect("an address"), routes).await
}

/// Starts a gateway with these routes at this address.
pub(crate) async fn gateway_at(address: SocketAddr, routes: &[&str]) -> Running {
    let routes = routes
        .iter()
        .map(|text| text.parse::<RouteSpec>().expect(text))
        .collect();
    let config = Config::new(routes).expect("routes that can be served");
    run(Gateway::new(&config).expect("addresses"), address).await
}

async fn run(gateway: Gateway, address: SocketAddr) -> Running {
    let listener = TcpListener::bind(address).await.expect("a free port");
    let address = listener.local_addr().expect("a bound address");
    let (stop, stopped) = oneshot::channel();
    let mut task = JoinSet::new();
    task.spawn(async move {
        let shutdown = async { stopped.await.unwrap_or(()) };
        policy_gateway::run(
            gateway,
            &transport::Security::loopback(),
            listener,
            shutdown,
        )
        .await
        .expect("the gateway serves");
    });
    Running {
        address,
        stop,
        task,
    }
}

/// Starts a gateway with these routes on a free port; returns it with its handle for reloading.
pub(crate) async fn reloadable(routes: Vec<RouteSpec>) -> (Running, Gateway) {
    let config = Config::new(routes).expect("routes that can be served");
    let gateway = Gateway::new(&config).expect("addresses");
    let address = "127.0.0.1:0".parse().expect("an address");
    (run(gateway.clone(), address).await, gateway)
}

/// Starts a policy server that is not a gateway, on a free port.
pub(crate) async fn serve(policy: impl Policy) -> Running {
    serve_any(Any(Box::new(policy))).await
}

/// A policy of any type, so that the server is compiled only once.
struct Any(Box<dyn Policy>);

#[tonic::async_trait]
impl Policy for Any {
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

async fn serve_any(policy: Any) -> Running {
    let (health, health_service) = tonic_health::server::health_reporter();
    health.set_serving::<PolicyServer<Any>>().await;
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
    Running {
        address,
        stop,
        task,
    }
}

pub(crate) async fn client(address: SocketAddr) -> PolicyClient<Channel> {
    PolicyClient::connect(format!("http://{address}"))
        .await
        .expect("a server at the address")
}

/// Returns a loopback address at which nothing listens.
pub(crate) async fn unused_address() -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    listener.local_addr().expect("a bound address")
}

pub(crate) fn describe(policy: &str) -> DescribeRequest {
    DescribeRequest {
        protocol_version: proto::PROTOCOL_VERSION,
        policy: policy.to_owned(),
        suite: String::new(),
    }
}

pub(crate) fn reset(policy: &str, session: &str) -> ResetRequest {
    ResetRequest {
        policy: policy.to_owned(),
        session: session.to_owned(),
        suite: "libero_object".to_owned(),
        instruction: "pick up the milk and place it in the basket".to_owned(),
        seed: 7,
    }
}

pub(crate) fn infer(policy: &str, session: &str, query_index: u32) -> InferRequest {
    InferRequest {
        policy: policy.to_owned(),
        session: session.to_owned(),
        query_index,
        observation: Some(Observation::default()),
        under_way: None,
    }
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

/// Returns one chunk of actions of the given width.
pub(crate) fn chunk(actions: &[f32], action_width: u32) -> InferResponse {
    InferResponse {
        actions: actions.to_vec(),
        action_width,
    }
}

/// Query to a scripted policy.
pub(crate) struct Query {
    /// Seed of the session's Reset, if there was one.
    pub(crate) seed: Option<u64>,
    pub(crate) query_index: u32,
    /// Number of earlier queries, over all sessions.
    pub(crate) asked_before: u32,
}

/// A policy with a given description, whose answers a function computes. It does not check the
/// protocol itself.
pub(crate) struct Scripted {
    described: Box<dyn Fn() -> DescribeResponse + Send + Sync>,
    answer: Box<dyn Fn(Query) -> Result<InferResponse, Status> + Send + Sync>,
    seeds: Mutex<HashMap<String, u64>>,
    asked: AtomicU32,
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
            asked: AtomicU32::new(0),
        }
    }

    /// The same, but a function computes the description anew for each call.
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
        self.seeds
            .lock()
            .expect("no test panics here")
            .insert(session, seed);
        Ok(Response::new(ResetResponse {}))
    }

    async fn infer(
        &self,
        request: Request<InferRequest>,
    ) -> Result<Response<InferResponse>, Status> {
        let InferRequest {
            session,
            query_index,
            ..
        } = request.into_inner();
        let seed = self
            .seeds
            .lock()
            .expect("no test panics here")
            .get(&session)
            .copied();
        let asked_before = self.asked.fetch_add(1, Ordering::SeqCst);
        (self.answer)(Query {
            seed,
            query_index,
            asked_before,
        })
        .map(Response::new)
    }

    async fn infer_batch(
        &self,
        _: Request<InferBatchRequest>,
    ) -> Result<Response<InferBatchResponse>, Status> {
        Err(Status::unimplemented("one at a time"))
    }
}
