//! What a client brings along: the certificate authority that it trusts, and
//! the token that it shows.

use std::path::PathBuf;

use clap::Args;
use tonic::codegen::InterceptedService;
use tonic::codegen::http::Uri;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint};
use tonic::{Request, Status};

use crate::server::{HANDSHAKE_TIMEOUT, SecurityError, read_pem, tokens};
use crate::token::{Role, Token, TokenError};

/// How to get in where a server asks who is there.
#[derive(Args, Clone, Debug, Default)]
pub struct ClientArguments {
    /// File with this client's token, as `ROLE TOKEN` [or that line in
    /// ROLLOUT_TOKENS]
    #[arg(long, value_name = "FILE", env = "ROLLOUT_TOKEN_FILE")]
    pub token_file: Option<PathBuf>,
    /// Certificate authority of the servers, PEM, for https:// addresses
    #[arg(long, value_name = "FILE", env = "ROLLOUT_CA")]
    pub ca: Option<PathBuf>,
}

/// What a client brings along, read.
#[derive(Clone, Debug, Default)]
pub struct Access {
    token: Option<Token>,
    ca: Option<Certificate>,
}

/// A connection that shows its token with every call.
pub type Connection = InterceptedService<Channel, Bearer>;

/// Adds the token to a call.
#[derive(Clone, Debug)]
pub struct Bearer(Option<MetadataValue<Ascii>>);

/// A client that cannot be what it should. Reads after "failed to …".
#[derive(Debug, thiserror::Error)]
pub enum AccessError {
    /// The tokens are no use.
    #[error(transparent)]
    Tokens(#[from] TokenError),
    /// None of the tokens is for this program.
    #[error("find a token of role {roles}: add a line `ROLE TOKEN` to the token file")]
    NoToken {
        /// The roles that would do.
        roles: String,
    },
    /// The certificate authority cannot be read.
    #[error(transparent)]
    Certificate(#[from] SecurityError),
}

impl ClientArguments {
    /// Reads what the arguments and the environment name. `roles`: the ones
    /// that this program can use, best first.
    ///
    /// # Errors
    /// See [`AccessError`].
    pub fn access(&self, roles: &[Role]) -> Result<Access, AccessError> {
        let ca = match &self.ca {
            Some(path) => Some(Certificate::from_pem(read_pem(path)?)),
            None => None,
        };
        let token = match tokens(self.token_file.as_deref())? {
            Some(tokens) => {
                let token = tokens.for_role(roles).cloned();
                Some(token.ok_or_else(|| {
                    AccessError::NoToken {
                        roles: roles
                            .iter()
                            .map(|role| role.name())
                            .collect::<Vec<_>>()
                            .join(" or "),
                    }
                })?)
            }
            None => None,
        };
        Ok(Access { token, ca })
    }
}

impl Access {
    /// Nothing: for servers on this machine.
    pub fn none() -> Access {
        Access::default()
    }

    /// A connection that is made at the first call. A token goes over TLS, or to
    /// this machine; to anybody else it is not shown.
    ///
    /// # Errors
    /// When the certificate authority is no use.
    pub fn connect_lazy(&self, endpoint: Endpoint) -> Result<Connection, tonic::transport::Error> {
        let bearer = self.bearer(endpoint.uri());
        let channel = self.guarded(endpoint)?.connect_lazy();
        Ok(InterceptedService::new(channel, bearer))
    }

    /// A connection that is made now; as [`connect_lazy`](Self::connect_lazy)
    /// otherwise.
    ///
    /// # Errors
    /// When the certificate authority is no use, or nobody answers.
    pub async fn connect(&self, endpoint: Endpoint) -> Result<Connection, tonic::transport::Error> {
        let bearer = self.bearer(endpoint.uri());
        let channel = self.guarded(endpoint)?.connect().await?;
        Ok(InterceptedService::new(channel, bearer))
    }

    fn guarded(&self, endpoint: Endpoint) -> Result<Endpoint, tonic::transport::Error> {
        if !is_encrypted(endpoint.uri()) {
            return Ok(endpoint);
        }
        let tls = ClientTlsConfig::new().timeout(HANDSHAKE_TIMEOUT);
        endpoint.tls_config(match &self.ca {
            Some(ca) => tls.ca_certificate(ca.clone()),
            None => tls,
        })
    }

    fn bearer(&self, uri: &Uri) -> Bearer {
        Bearer(self.token_for(uri).and_then(|token| {
            // A token is visible ASCII: it always fits a header.
            let value: Option<MetadataValue<Ascii>> =
                format!("Bearer {}", token.secret()).parse().ok();
            value.map(|mut value| {
                value.set_sensitive(true);
                value
            })
        }))
    }

    fn token_for(&self, uri: &Uri) -> Option<&Token> {
        let token = self.token.as_ref();
        token.filter(|_| is_encrypted(uri) || is_this_machine(uri))
    }
}

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(value) = &self.0 {
            request
                .metadata_mut()
                .insert("authorization", value.clone());
        }
        Ok(request)
    }
}

fn is_encrypted(uri: &Uri) -> bool {
    uri.scheme_str() == Some("https")
}

fn is_this_machine(uri: &Uri) -> bool {
    let host = uri.host().unwrap_or_default();
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    let address = bare.parse::<std::net::IpAddr>();
    bare == "localhost" || address.is_ok_and(|ip| ip.to_canonical().is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shows_its_token(url: &str) -> bool {
        let access = Access {
            token: Some(Token::parse("0123456789abcdef").expect("a token")),
            ca: None,
        };
        access.token_for(&url.parse().expect(url)).is_some()
    }

    #[test]
    fn a_token_is_never_sent_in_the_clear_to_another_machine() {
        for url in [
            "https://h:1",
            "http://127.0.0.1:1",
            "http://[::1]:1",
            "http://localhost:1",
        ] {
            assert!(shows_its_token(url), "{url}");
        }
        for url in ["http://h:1", "http://10.0.0.7:1", "http://localhost.evil:1"] {
            assert!(!shows_its_token(url), "{url}");
        }
    }
}
