//! gRPC servers of other projects, and older servers of this one.

use std::convert::Infallible;
use std::future::{Ready, ready};
use std::net::SocketAddr;
use std::task::{Context, Poll};

use tokio::net::TcpListener;
use tokio::task::JoinSet;
use tonic::Status;
use tonic::body::Body;
use tonic::codegen::Service;
use tonic::codegen::http::{Request, Response};
use tonic::server::NamedService;
use tonic::transport::server::TcpIncoming;
use tonic::transport::{Error, Server};

/// Service that answers calls of one path with FAILED_PRECONDITION, and all others with
/// UNIMPLEMENTED.
#[derive(Clone)]
struct SinglePath(&'static str);

impl Service<Request<Body>> for SinglePath {
    type Response = Response<Body>;
    type Error = Infallible;
    type Future = Ready<Result<Self::Response, Infallible>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, request: Request<Body>) -> Self::Future {
        let status = match request.uri().path() == self.0 {
            true => Status::failed_precondition("another version"),
            false => Status::unimplemented(""),
        };
        ready(Ok(status.into_http()))
    }
}

impl NamedService for SinglePath {
    const NAME: &'static str = "rollout.coordinator.v1.OperatorService";
}

/// Set of servers, which end when the set is dropped.
pub(crate) type Servers = JoinSet<Result<(), Error>>;

/// Starts a server that implements the call of one path.
pub(crate) async fn serve_path(path: &'static str, servers: &mut Servers) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("an address");
    let server = Server::builder().add_service(SinglePath(path));
    servers.spawn(server.serve_with_incoming(TcpIncoming::from(listener)));
    address
}
