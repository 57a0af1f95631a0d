//! Client credentials: the trusted certificate authority and the token.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::task::{Context, Poll};

use clap::Args;
use hyper_util::rt::TokioIo;
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore, crypto};
use tonic::codegen::http::{HeaderValue, Uri};
use tonic::codegen::{BoxFuture, InterceptedService, Service};
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::transport::{Certificate, ClientTlsConfig, Endpoint};
use tonic::{Request, Status};

use crate::repeat::Repeating;
use crate::server::{HANDSHAKE_TIMEOUT, SecurityError, read_pem, tokens};
use crate::token::{Role, Token, TokenError, Tokens};
use crate::users::{Untrusted, check_server};

/// Default port of `http://` addresses.
const HTTP_PORT: u16 = 80;

/// The credentials for a server that requires them.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Connection")]
pub struct ClientArguments {
    /// File with this client's token, as `ROLE TOKEN` [or that line in
    /// ROLLOUT_TOKENS]
    #[arg(long, value_name = "FILE", env = "ROLLOUT_TOKEN_FILE", hide_short_help = true)]
    pub token_file: Option<PathBuf>,
    /// Certificate authority of the servers, PEM, for https:// addresses
    #[arg(long, value_name = "FILE", env = "ROLLOUT_CA", hide_short_help = true)]
    pub ca: Option<PathBuf>,
}

/// Credentials of a client, read from its files.
#[derive(Clone, Debug, Default)]
pub struct Access {
    token: Option<Token>,
    /// Trusted certificates, PEM.
    ca: Option<Vec<u8>>,
}

/// A connection that sends its token with every call, and survives the end of its transport.
pub type Connection = InterceptedService<Repeating, Bearer>;

/// Adds the token to a call.
#[derive(Clone, Debug)]
pub struct Bearer {
    value: Option<MetadataValue<Ascii>>,
}

/// Connects to servers on this machine, and drops a connection over which a token may not be sent
/// unencrypted. The check is per connection, because a channel reconnects whenever its connection
/// breaks.
#[derive(Clone, Copy, Debug)]
struct LocalConnector;

impl Service<Uri> for LocalConnector {
    type Response = TokioIo<TcpStream>;
    type Error = Box<dyn Error + Send + Sync>;
    type Future = BoxFuture<Self::Response, Self::Error>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Self::Error>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, uri: Uri) -> Self::Future {
        Box::pin(async move {
            let port = uri.port_u16().unwrap_or(HTTP_PORT);
            let stream = TcpStream::connect((bare_host(&uri), port)).await?;
            stream.set_nodelay(true)?;
            check_server(&stream).await?;
            Ok(TokioIo::new(stream))
        })
    }
}

/// Client credentials that cannot be used. The message follows "failed to …".
#[derive(Debug, thiserror::Error)]
pub enum AccessError {
    #[error(transparent)]
    Tokens(#[from] TokenError),
    #[error("find a token of role {roles}: add a line `ROLE TOKEN` to the token file")]
    NoToken { roles: String },
    #[error(transparent)]
    Certificate(#[from] SecurityError),
    #[error("use {} as a certificate authority: it must hold certificates as PEM", path.display())]
    Authority { path: PathBuf },
    #[error("call {host} over TLS: write the name of a host, or its IP address")]
    Host { host: String },
}

impl ClientArguments {
    /// Reads the credentials that the arguments and the environment name. `roles` are the roles
    /// whose tokens this program can use, in order of preference.
    pub fn access(&self, roles: &[Role]) -> Result<Access, AccessError> {
        let tokens = tokens(self.token_file.as_deref())?;
        Access::new(self.ca.as_deref(), tokens, roles)
    }
}

impl Access {
    /// Returns empty credentials, for servers on this machine.
    pub fn none() -> Access {
        Access::default()
    }

    /// Reads credentials from files only, not from the environment: for a program that is both a
    /// server with its own tokens and a client of other servers.
    pub fn from_files(
        ca: Option<&Path>,
        token_file: Option<&Path>,
        roles: &[Role],
    ) -> Result<Access, AccessError> {
        let tokens = token_file.map(Tokens::read).transpose()?;
        Access::new(ca, tokens, roles)
    }

    fn new(
        ca: Option<&Path>,
        tokens: Option<Tokens>,
        roles: &[Role],
    ) -> Result<Access, AccessError> {
        let ca = ca.map(authority).transpose()?;
        let token = match tokens {
            Some(tokens) => {
                let token = tokens.for_role(roles).cloned();
                Some(token.ok_or_else(|| AccessError::NoToken {
                    roles: roles.iter().map(|role| role.name()).collect::<Vec<_>>().join(" or "),
                })?)
            }
            None => None,
        };
        Ok(Access { token, ca })
    }

    /// Returns a connection that is opened at the first call. The token is sent only over TLS or to
    /// this machine.
    pub fn connect_lazy(&self, endpoint: Endpoint) -> Result<Connection, AccessError> {
        let bearer = self.bearer(endpoint.uri());
        let channel = match self.sends_token_unencrypted(endpoint.uri()) {
            true => endpoint.connect_with_connector_lazy(LocalConnector),
            false => self.with_tls(endpoint)?.connect_lazy(),
        };
        Ok(InterceptedService::new(Repeating(channel), bearer))
    }

    fn with_tls(&self, endpoint: Endpoint) -> Result<Endpoint, AccessError> {
        if !Access::is_encrypted(endpoint.uri()) {
            return Ok(endpoint);
        }
        let host = endpoint.uri().host().unwrap_or_default().to_owned();
        let tls = ClientTlsConfig::new().timeout(HANDSHAKE_TIMEOUT);
        let endpoint = endpoint.tls_config(match &self.ca {
            Some(ca) => tls.ca_certificate(Certificate::from_pem(ca)),
            None => tls,
        });
        endpoint.map_err(|_| AccessError::Host { host })
    }

    /// Checks a new connection to `uri`, for protocols other than gRPC, before the token is sent
    /// over it. Fails if the token would be sent unencrypted to another user of this machine, or to
    /// a user that the kernel does not report.
    pub async fn check_connection(
        &self,
        uri: &Uri,
        connection: &TcpStream,
    ) -> Result<(), Untrusted> {
        if self.sends_token_unencrypted(uri) { check_server(connection).await } else { Ok(()) }
    }

    /// Opens a TLS connection to `host` for protocols other than gRPC.
    pub async fn encrypt(
        &self,
        stream: TcpStream,
        host: &str,
    ) -> std::io::Result<TlsStream<TcpStream>> {
        let host = ServerName::try_from(host.to_owned()).map_err(std::io::Error::other)?;
        // The certificates were checked when their file was read.
        let roots =
            roots(self.ca.as_deref().unwrap_or_default()).unwrap_or_else(RootCertStore::empty);
        let provider = Arc::new(crypto::ring::default_provider());
        let config = ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(std::io::Error::other)?
            .with_root_certificates(roots)
            .with_no_client_auth();
        let handshake = TlsConnector::from(Arc::new(config)).connect(host, stream);
        tokio::time::timeout(HANDSHAKE_TIMEOUT, handshake).await?
    }

    pub(crate) fn is_encrypted(uri: &Uri) -> bool {
        matches!(uri.scheme_str(), Some("https" | "wss"))
    }

    /// Returns the `authorization` header of this scheme, if the token may be sent to `uri`.
    pub fn authorization(&self, uri: &Uri, scheme: &str) -> Option<HeaderValue> {
        let token = self.token_for(uri)?;
        // A token is visible ASCII: it always fits a header.
        let mut value: HeaderValue = format!("{scheme} {}", token.secret()).parse().ok()?;
        value.set_sensitive(true);
        Some(value)
    }

    fn bearer(&self, uri: &Uri) -> Bearer {
        let value = self.authorization(uri, "Bearer");
        let mut value = value.and_then(|text| MetadataValue::try_from(text.as_bytes()).ok());
        if let Some(value) = &mut value {
            value.set_sensitive(true);
        }
        Bearer { value }
    }

    fn sends_token_unencrypted(&self, uri: &Uri) -> bool {
        !Access::is_encrypted(uri) && self.token_for(uri).is_some()
    }

    fn token_for(&self, uri: &Uri) -> Option<&Token> {
        let token = self.token.as_ref();
        token.filter(|_| Access::is_encrypted(uri) || is_this_machine(uri))
    }
}

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(value) = &self.value {
            request.metadata_mut().insert("authorization", value.clone());
        }
        Ok(request)
    }
}

fn authority(path: &Path) -> Result<Vec<u8>, AccessError> {
    let pem = read_pem(path)?;
    match roots(&pem) {
        Some(roots) if !roots.is_empty() => Ok(pem),
        _ => Err(AccessError::Authority { path: path.to_owned() }),
    }
}

/// Parses certificates; `None` if one of them is invalid.
fn roots(pem: &[u8]) -> Option<RootCertStore> {
    let mut roots = RootCertStore::empty();
    for certificate in CertificateDer::pem_slice_iter(pem) {
        roots.add(certificate.ok()?).ok()?;
    }
    Some(roots)
}

/// Returns the host of a URI, an IPv6 address without its brackets.
fn bare_host(uri: &Uri) -> &str {
    let host = uri.host().unwrap_or_default();
    host.trim_start_matches('[').trim_end_matches(']')
}

fn is_this_machine(uri: &Uri) -> bool {
    let bare = bare_host(uri);
    let address = bare.parse::<std::net::IpAddr>();
    bare == "localhost" || address.is_ok_and(|ip| ip.to_canonical().is_loopback())
}

#[cfg(test)]
mod tests {
    use std::future::poll_fn;
    use std::io::{BufRead, BufReader};

    use tonic::body::Body;
    use tonic::codegen::http;

    use super::*;

    fn sends_token(url: &str) -> bool {
        let access =
            Access { token: Some(Token::parse("0123456789abcdef").expect("a token")), ca: None };
        access.token_for(&url.parse().expect(url)).is_some()
    }

    #[test]
    fn a_token_is_never_sent_in_the_clear_to_another_machine() {
        for url in [
            "https://h:1",
            "http://127.0.0.1:1",
            "http://[::1]:1",
            "http://localhost:1",
            "wss://h:1",
        ] {
            assert!(sends_token(url), "{url}");
        }
        for url in ["http://h:1", "ws://h:1", "http://10.0.0.7:1", "http://localhost.evil:1"] {
            assert!(!sends_token(url), "{url}");
        }
    }

    /// Program of another user that listens on a port and prints the number of bytes received.
    const FOREIGN_SERVER: &str = "
import os, socket, sys
os.setuid(4242)
listener = socket.create_server(('127.0.0.1', int(sys.argv[1])))
print('listening', flush=True)
print('got', len(listener.accept()[0].recv(1000)), flush=True)
";

    /// A channel that reconnects repeats the check of the server's user before it sends anything.
    #[tokio::test]
    async fn a_server_is_checked_at_every_connection() {
        if !rustix::process::geteuid().is_root() {
            println!("skipped: only root starts programs as another user");
            return;
        }
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await;
        let listener = listener.expect("a free port");
        let port = listener.local_addr().expect("an address").port();
        let access =
            Access { token: Some(Token::parse("0123456789abcdef").expect("a token")), ca: None };
        let url = format!("http://127.0.0.1:{port}");
        let endpoint = Endpoint::from_shared(url.clone()).expect("a URL");
        let connection = access.connect_lazy(endpoint).expect("a connection");
        let call = async || {
            let mut connection = connection.clone();
            let ready = poll_fn(|context| connection.poll_ready(context)).await;
            ready.expect("a lazy channel takes calls");
            let request = http::Request::post(&url).body(Body::empty());
            let answer = connection.call(request.expect("a request")).await;
            crate::chain(&answer.expect_err("no gRPC server"))
        };
        let closing = async {
            while let Ok((stream, _)) = listener.accept().await {
                drop(stream);
            }
        };
        let broken = tokio::select! {
            broken = call() => broken,
            () = closing => panic!("the listener failed"),
        };
        assert!(!broken.contains("another user"), "{broken}");
        drop(listener);

        let mut foreign_server = std::process::Command::new("python3")
            .args(["-c", FOREIGN_SERVER, &port.to_string()])
            .stdout(std::process::Stdio::piped())
            .spawn()
            .expect("python3 runs");
        let mut output =
            BufReader::new(foreign_server.stdout.take().expect("stdout is piped")).lines();
        let mut line = || output.next().expect("a line").expect("UTF-8");
        assert_eq!(line(), "listening");
        let refused = call().await;
        assert!(refused.contains("another user of this machine"), "{refused}");
        assert_eq!(line(), "got 0");
        assert!(foreign_server.wait().expect("it ends").success());
    }
}
