//! Servers on free ports of the loopback, and clients of them.

use std::net::SocketAddr;

use policy_gateway::config::{Config, RouteSpec};
use proto::policy::{
    DescribeRequest, DescribeResponse, InferRequest, Observation, ResetRequest,
    policy_client::PolicyClient, policy_server::PolicyServer,
};
use tokio::{net::TcpListener, sync::oneshot, task::JoinHandle};
use tonic::transport::{Channel, Server, server::TcpIncoming};

/// A server in this process; stops, and frees its port, when told to.
pub(crate) struct Running {
    pub(crate) address: SocketAddr,
    stop: oneshot::Sender<()>,
    task: JoinHandle<()>,
}

impl Running {
    pub(crate) async fn stop(self) {
        self.stop.send(()).expect("the server still runs");
        self.task.await.expect("the server stops in order");
    }

    pub(crate) async fn client(&self) -> PolicyClient<Channel> {
        client(self.address).await
    }
}

/// A gateway with these routes, on a free port.
pub(crate) async fn gateway(routes: &[&str]) -> Running {
    gateway_at("127.0.0.1:0".parse().expect("an address"), routes).await
}

/// A gateway with these routes, at this address.
pub(crate) async fn gateway_at(address: SocketAddr, routes: &[&str]) -> Running {
    let routes = routes
        .iter()
        .map(|text| text.parse::<RouteSpec>().expect(text))
        .collect();
    let config = Config::new(routes).expect("routes that can be served");
    let listener = TcpListener::bind(address).await.expect("a free port");
    let address = listener.local_addr().expect("a bound address");
    let (stop, stopped) = oneshot::channel();
    let task = tokio::spawn(async move {
        let shutdown = async { stopped.await.unwrap_or(()) };
        policy_gateway::run(config, listener, shutdown)
            .await
            .expect("the gateway serves");
    });
    Running {
        address,
        stop,
        task,
    }
}

/// A policy server that is not a gateway, on a free port.
pub(crate) async fn serve(policy: impl proto::policy::policy_server::Policy) -> Running {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("a bound address");
    let (stop, stopped) = oneshot::channel();
    let task = tokio::spawn(async move {
        Server::builder()
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

/// An address of the loopback at which nothing listens.
pub(crate) async fn unused_address() -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    listener.local_addr().expect("a bound address")
}

pub(crate) fn describe(policy: &str) -> DescribeRequest {
    DescribeRequest {
        protocol_version: proto::PROTOCOL_VERSION,
        policy: policy.to_owned(),
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
    }
}

/// A description that any gateway accepts.
pub(crate) fn description(name: &str, horizon: u32) -> DescribeResponse {
    DescribeResponse {
        protocol_version: proto::PROTOCOL_VERSION,
        name: name.to_owned(),
        horizon,
        execute: 1,
        ..DescribeResponse::default()
    }
}
