//! Runs a gateway in this process in front of a server of another protocol, so that
//! `policy-gateway check` sees the same answers as workers.

use std::net::SocketAddr;

use policy_backends::UnusableBackend;
use thiserror::Error;
use tokio::{net::TcpListener, task::JoinSet};
use transport::Security;

use crate::{
    config::{AccessFiles, Config, ConfigError, RouteSpec},
    service::Gateway,
};

/// Gateway in front of a server. Dropping this value stops the gateway.
pub struct Front {
    pub address: SocketAddr,
    _task: JoinSet<()>,
}

impl Front {
    /// Starts a gateway in front of the server at `url`.
    pub async fn start(url: &str, access: AccessFiles) -> Result<Self, FrontError> {
        let backend = url.parse().map_err(ConfigError::from)?;
        let route = RouteSpec { access, ..RouteSpec::new("policy".parse()?, vec![backend]) };
        let gateway = Gateway::new(&Config::new(vec![route])?)?;
        let listener = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], 0))).await?;
        let address = listener.local_addr()?;
        let mut task = JoinSet::new();
        task.spawn(async move {
            let security = Security::loopback();
            let until_dropped = std::future::pending();
            if let Err(error) = crate::run(gateway, &security, listener, until_dropped).await {
                tracing::error!("the gateway in front of the server failed to {error}");
            }
        });
        Ok(Self { address, _task: task })
    }
}

/// Reason why no gateway can be started in front of a server. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum FrontError {
    /// The address is invalid, or a TLS server has no certificate authority.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The back-end cannot be created.
    #[error(transparent)]
    Backend(#[from] UnusableBackend),
    #[error("open a port of 127.0.0.1 for the gateway of this command")]
    Listen(#[from] std::io::Error),
}
