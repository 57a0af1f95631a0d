//! Access settings of a server, checked before it listens, and limits of every connection.

use std::fs::File;
use std::io::{self, Read};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use tonic::codegen::http::HeaderMap;
use tonic::transport::{Identity, Server, ServerTlsConfig};

use crate::browser_sessions::BrowserSessions;
use crate::gate::{Gate, Resource};
use crate::private::exposed;
use crate::token::{Role, TokenError, Tokens};
use crate::users::Users;

/// Timeout of a TLS handshake.
pub const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(10);
/// Concurrent calls per connection: every slot of a large worker may wait for a job, commit and
/// send a video.
pub const MAX_STREAMS_PER_CONNECTION: u32 = 1_024;
/// Largest headers of a call, bytes.
pub const MAX_HEADER_BYTES: u32 = 16 << 10;
/// Interval of keepalive pings on an idle connection, which free the connections of machines that
/// vanished.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(30);
/// Longest wait for the answer to a keepalive ping.
const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(20);
/// The environment variable that holds the lines of a token file.
pub(crate) const TOKENS_VARIABLE: &str = "ROLLOUT_TOKENS";

/// Access rules of a server.
#[derive(Args, Clone, Debug, Default)]
pub struct ServerArguments {
    /// Certificate chain of this server, PEM. With it, clients write https://
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// Private key of the certificate in --tls-cert, PEM
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// File of accepted tokens, one `ROLE TOKEN` per line, the role being
    /// worker, operator or viewer [or their lines in ROLLOUT_TOKENS]
    #[arg(long, value_name = "FILE", env = "ROLLOUT_TOKEN_FILE")]
    pub token_file: Option<PathBuf>,
    /// Listens to other machines without TLS or without tokens: for networks
    /// that only trusted people reach
    #[arg(long)]
    pub insecure: bool,
    /// Accepts every user of this machine when listening on a loopback address without tokens; by
    /// default, accepts only the user that started the server, and root
    #[arg(long, hide_short_help = true)]
    pub insecure_loopback: bool,
}

/// Access rules of a server's port.
#[derive(Clone, Debug)]
pub struct Security {
    identity: Option<Identity>,
    tokens: Option<Tokens>,
    users: Users,
    browser_sessions: BrowserSessions,
}

/// A server behind a [`Gate`].
pub type GatedServer = Server<tower_layer::Stack<Gate, tower_layer::Identity>>;

/// Reason why a server may not or cannot listen with these settings. The message follows
/// "failed to …".
#[derive(Debug, thiserror::Error)]
pub enum SecurityError {
    #[error(
        "listen on {address}: other machines can reach that, and {missing}; give --tls-cert, \
         --tls-key and --token-file, or --insecure if only trusted people reach this network"
    )]
    Unguarded { address: SocketAddr, missing: &'static str },
    #[error(transparent)]
    Tokens(#[from] TokenError),
    #[error("read {}: give a PEM file that this user may read", path.display())]
    Pem { path: PathBuf, source: io::Error },
    #[error(
        "read private key {}: its permissions, {mode:04o}, let other users access it; restrict \
         them with `chmod {chmod} {}`",
        path.display(),
        path.display()
    )]
    Exposed { path: PathBuf, mode: u32, chmod: &'static str },
    #[error(
        "use the certificate and the key: give --tls-cert a PEM chain, and --tls-key the private \
         key of its first certificate, as PEM"
    )]
    Tls,
}

impl ServerArguments {
    /// Reads the certificate, key and tokens that the arguments and the environment name, and
    /// checks that they suffice for an address.
    pub fn security(&self, address: SocketAddr) -> Result<Security, SecurityError> {
        let identity = match (&self.tls_cert, &self.tls_key) {
            (Some(certificate), Some(key)) => {
                Some(Identity::from_pem(read_pem(certificate)?, read_key(key)?))
            }
            _ => None,
        };
        let tokens = tokens(self.token_file.as_deref())?;
        let missing = match (&identity, &tokens) {
            (None, None) => Some("every client would be admitted, in the clear"),
            (None, Some(_)) => Some("tokens would be sent in the clear"),
            (Some(_), None) => Some("every client would be admitted without a token"),
            (Some(_), Some(_)) => None,
        };
        match missing {
            Some(missing) if !self.insecure && !address.ip().to_canonical().is_loopback() => {
                Err(SecurityError::Unguarded { address, missing })
            }
            _ => {
                let accepts_own_user_only = tokens.is_none()
                    && address.ip().to_canonical().is_loopback()
                    && !self.insecure_loopback;
                let users = if accepts_own_user_only { Users::Own } else { Users::Any };
                Ok(Security::new(identity, tokens, users))
            }
        }
    }
}

impl Security {
    /// Returns the rules of a server on a loopback address, which requires no token and accepts
    /// only the user that started it, and root.
    pub fn loopback() -> Security {
        Security::new(None, None, Users::Own)
    }

    fn new(identity: Option<Identity>, tokens: Option<Tokens>, users: Users) -> Security {
        Security {
            users,
            browser_sessions: BrowserSessions::new(identity.is_some()),
            identity,
            tokens,
        }
    }

    /// Returns true if clients write https://.
    pub fn is_encrypted(&self) -> bool {
        self.identity.is_some()
    }

    /// Returns true if callers must send a token.
    pub fn asks_for_tokens(&self) -> bool {
        self.tokens.is_some()
    }

    /// Logs in a browser that sends the token of one of these roles. Returns the `Set-Cookie`
    /// value, or `None` if the server has no tokens, the token is unknown or of another role, or
    /// the system provides no randomness.
    pub fn log_in(&self, token: &str, roles: &[Role]) -> Option<String> {
        let role = self.tokens.as_ref()?.role_of(token)?;
        roles.contains(&role).then(|| self.browser_sessions.log_in())?
    }

    /// Logs out the browser that sent a request. Returns the value of `Set-Cookie`.
    pub fn log_out(&self, headers: &HeaderMap) -> String {
        self.browser_sessions.log_out(headers)
    }

    /// Returns the gate for a server with this table of resources and, if it has pages, this path
    /// of its log-in page.
    pub fn gate(&self, resource: fn(&str) -> Resource, log_in: Option<&'static str>) -> Gate {
        let (tokens, browser_sessions) = (self.tokens.clone(), self.browser_sessions.clone());
        Gate::new(tokens, self.users, resource, log_in, browser_sessions)
    }

    pub fn server(&self, resource: fn(&str) -> Resource) -> Result<GatedServer, SecurityError> {
        self.guarded(self.gate(resource, None))
    }

    /// Builds a server of gRPC calls and pages. Browsers without a session are redirected to the
    /// path `log_in`.
    pub fn server_with_pages(
        &self,
        resource: fn(&str) -> Resource,
        log_in: &'static str,
    ) -> Result<GatedServer, SecurityError> {
        let server = self.guarded(self.gate(resource, Some(log_in)))?;
        // Without TLS, browsers use HTTP/1 only.
        Ok(server.accept_http1(true))
    }

    fn guarded(&self, gate: Gate) -> Result<GatedServer, SecurityError> {
        let mut server = Server::builder()
            .http2_keepalive_interval(Some(KEEPALIVE_INTERVAL))
            .http2_keepalive_timeout(Some(KEEPALIVE_TIMEOUT))
            .http2_max_header_list_size(MAX_HEADER_BYTES)
            .max_concurrent_streams(MAX_STREAMS_PER_CONNECTION);
        if let Some(identity) = &self.identity {
            let tls = ServerTlsConfig::new().identity(identity.clone()).timeout(HANDSHAKE_TIMEOUT);
            server = server.tls_config(tls).map_err(|_| SecurityError::Tls)?;
        }
        Ok(server.layer(gate))
    }
}

/// Reads tokens from the file, or else from the environment; `None` if neither is set.
pub(crate) fn tokens(file: Option<&Path>) -> Result<Option<Tokens>, TokenError> {
    if let Some(file) = file {
        return Tokens::read(file).map(Some);
    }
    match std::env::var(TOKENS_VARIABLE) {
        Ok(text) if !text.is_empty() => Tokens::parse(&text, TOKENS_VARIABLE).map(Some),
        _ => Ok(None),
    }
}

/// Reads a private key. Fails if other users can access the file.
fn read_key(path: &Path) -> Result<Vec<u8>, SecurityError> {
    let unreadable = |source| SecurityError::Pem { path: path.to_owned(), source };
    let mut file = File::open(path).map_err(unreadable)?;
    if let Some((mode, chmod)) = exposed(&file).map_err(unreadable)? {
        return Err(SecurityError::Exposed { path: path.to_owned(), mode, chmod });
    }
    let mut key = Vec::new();
    file.read_to_end(&mut key).map_err(unreadable)?;
    Ok(key)
}

pub(crate) fn read_pem(path: &Path) -> Result<Vec<u8>, SecurityError> {
    std::fs::read(path).map_err(|source| SecurityError::Pem { path: path.to_owned(), source })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arguments(insecure: bool) -> ServerArguments {
        ServerArguments { insecure, ..ServerArguments::default() }
    }

    #[test]
    fn only_loopback_listens_without_tokens_unless_insecure() {
        let refused = |address: &str, insecure| {
            let address = address.parse().expect(address);
            arguments(insecure).security(address).is_err()
        };
        for loopback in ["127.0.0.1:1", "127.9.9.9:0", "[::1]:1", "[::ffff:127.0.0.1]:1"] {
            assert!(!refused(loopback, false), "{loopback}");
        }
        for open in ["0.0.0.0:1", "[::]:1", "10.0.0.7:1", "[::ffff:10.0.0.7]:1"] {
            assert!(refused(open, false), "{open}");
            assert!(!refused(open, true), "{open}");
        }
    }

    #[test]
    fn tokens_without_tls_do_not_allow_a_public_address() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(file.path(), "worker 0123456789abcdef").expect("written");
        let arguments = ServerArguments {
            token_file: Some(file.path().to_owned()),
            ..ServerArguments::default()
        };
        let address = "0.0.0.0:7411".parse().expect("an address");
        let error = arguments.security(address).expect_err("in the clear");
        for word in ["0.0.0.0:7411", "in the clear", "--tls-cert", "--insecure"] {
            assert!(error.to_string().contains(word), "{error}");
        }
    }
}
