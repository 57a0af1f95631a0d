//! Gateways on free loopback ports, and messages to them.

use std::net::SocketAddr;

use policy_gateway::config::{Config, RouteSpec};
use policy_gateway::service::Gateway;
use proto::policy::policy_client::PolicyClient;
use proto::policy::policy_server::Policy;
use proto::policy::{DescribeRequest, InferRequest, Observation, ResetRequest};
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use tonic::transport::Channel;

pub(crate) use crate::scripted::{Query, Running, Scripted, chunk, client, description, serve};

/// Starts a gateway with these routes on a free port.
pub(crate) async fn gateway(routes: &[&str]) -> Running {
    gateway_at("127.0.0.1:0".parse().expect("an address"), routes).await
}

pub(crate) async fn gateway_at(address: SocketAddr, routes: &[&str]) -> Running {
    let routes = routes.iter().map(|text| text.parse::<RouteSpec>().expect(text)).collect();
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
        policy_gateway::run(gateway, &transport::Security::loopback(), listener, shutdown)
            .await
            .expect("the gateway serves");
    });
    Running::new(address, stop, task)
}

/// Starts a gateway with these routes on a free port; returns the running gateway and a handle that
/// reloads it.
pub(crate) async fn reloadable(routes: Vec<RouteSpec>) -> (Running, Gateway) {
    let config = Config::new(routes).expect("routes that can be served");
    let gateway = Gateway::new(&config).expect("addresses");
    let address = "127.0.0.1:0".parse().expect("an address");
    (run(gateway.clone(), address).await, gateway)
}

/// Serves a policy behind a gateway's route `x`. Returns both, and a client of the gateway.
pub(crate) async fn behind(policy: impl Policy) -> (Running, Running, PolicyClient<Channel>) {
    let server = serve(policy).await;
    let gateway = gateway(&[&format!("x=grpc://{}", server.address)]).await;
    let client = gateway.client().await;
    (server, gateway, client)
}

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
