//! Gateway between workers and policy servers: routes each query of a worker to the policy that the
//! query names, and checks every answer before an action reaches a robot. The gateway offers
//! workers the same service as a policy server. It does not simulate, perturb or clip.

#![forbid(unsafe_code)]

use std::convert::Infallible;
use std::pin::Pin;
use std::time::Duration;

use policy_backends::http2::{CONNECTION_WINDOW_BYTES, MAX_FRAME_BYTES, STREAM_WINDOW_BYTES};
use proto::policy::policy_server::PolicyServer;
use thiserror::Error;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use transport::{Incoming, Security, SecurityError, innermost};

use crate::service::Gateway;

mod access;
pub mod batch;
pub mod config;
pub mod doctor;
pub mod health;
pub mod observation_budget;
pub mod pace;
pub mod route;
pub mod service;

/// Time limit for queries in flight at shutdown.
pub const SHUTDOWN_GRACE: Duration = Duration::from_secs(10);

/// Serves `rollout.policy.v1` and `grpc.health.v1` on `listener` until `shutdown` resolves, then
/// lets queries in flight finish for at most [`SHUTDOWN_GRACE`]. No back-end is called before the
/// first request, so that the gateway starts and runs whatever the state of the back-ends.
pub async fn run(
    gateway: Gateway,
    security: &Security,
    listener: TcpListener,
    shutdown: impl Future<Output = ()> + Send,
) -> Result<(), RunError> {
    // Boxed, so that the server is compiled once instead of once per caller's future type.
    serve(gateway, security, listener, Box::pin(shutdown)).await
}

async fn serve(
    gateway: Gateway,
    security: &Security,
    listener: TcpListener,
    shutdown: Pin<Box<dyn Future<Output = ()> + Send + '_>>,
) -> Result<(), RunError> {
    let policies = PolicyServer::new(gateway)
        .max_decoding_message_size(proto::MAX_MESSAGE_BYTES)
        .max_encoding_message_size(proto::MAX_MESSAGE_BYTES);
    let (health, health_service) = tonic_health::server::health_reporter();
    health.set_serving::<PolicyServer<Gateway>>().await;

    let (stopping, stopped) = oneshot::channel::<Infallible>();
    let served = security
        .server(access::resource)?
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .max_frame_size(MAX_FRAME_BYTES)
        .add_service(health_service)
        .add_service(policies)
        .serve_with_incoming_shutdown(Incoming::new(listener), async move {
            shutdown.await;
            health.set_not_serving::<PolicyServer<Gateway>>().await;
            drop(stopping);
        });
    let grace_is_over = async {
        // The sender never sends; its drop ends this wait.
        let _ = stopped.await;
        tokio::time::sleep(SHUTDOWN_GRACE).await;
    };
    tokio::select! {
        served = served => served.map_err(|error| RunError::Socket {
            problem: innermost(&error),
        }),
        () = grace_is_over => {
            tracing::warn!(
                "stopping with queries still in flight after {} s",
                SHUTDOWN_GRACE.as_secs()
            );
            Ok(())
        }
    }
}

/// Reason why a gateway cannot serve.
#[derive(Debug, Error)]
pub enum RunError {
    #[error("serve policies: the listening socket failed ({problem})")]
    Socket { problem: String },
    /// The TLS certificate or the tokens cannot be used.
    #[error(transparent)]
    Security(#[from] SecurityError),
}
