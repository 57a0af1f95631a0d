//! WebSocket connections to policy servers of other protocols: TCP, TLS, token, handshake, and a
//! diagnosis of failures. The back-ends interpret the messages.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use benchmark::attempt::CONNECTED_SINCE;
use futures_util::{FutureExt, SinkExt, StreamExt};
use proto::policy::Setting;
use time::OffsetDateTime;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::error::ProtocolError;
use tokio_tungstenite::tungstenite::http::header::AUTHORIZATION;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{self, Message};
use tokio_tungstenite::{WebSocketStream, client_async_with_config};
use tonic::codegen::http::Uri;
use tonic::codegen::http::uri::InvalidUri;
use tonic::transport::Endpoint;
use transport::{Access, ConnectError, Fault, Peer, ServerKind, Settings};

use crate::backend::{BackendError, SETTINGS};
use crate::grpc::CONNECT_TIMEOUT;

/// Largest message of a server, bytes. The longest chunk of actions has 58 kB, and metadata and
/// HELLO are shorter; a decoded message takes up to forty times as much memory as its bytes.
const MAX_MESSAGE_BYTES: usize = 1 << 20;
/// Longest wait for handshake and first message, which a server may delay while it computes.
const GREETING_TIMEOUT: Duration = Duration::from_secs(30);

#[derive(Clone, Copy, Debug)]
pub(super) struct Schemes {
    pub(super) clear: &'static str,
    pub(super) encrypted: &'static str,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HostPort {
    pub authority: String,
    pub encrypted: bool,
}

impl HostPort {
    /// Parses `SCHEME://HOST:PORT`, optionally with a query but without a path.
    pub(super) fn read(uri: &Uri, schemes: Schemes) -> Option<Self> {
        let encrypted = match uri.scheme_str()? {
            scheme if scheme == schemes.clear => false,
            scheme if scheme == schemes.encrypted => true,
            _ => return None,
        };
        let is_complete = uri.host().is_some_and(|host| !host.is_empty())
            && uri.port_u16().is_some()
            && uri.path() == "/";
        is_complete.then(|| Self {
            authority: uri.authority().map(ToString::to_string).unwrap_or_default(),
            encrypted,
        })
    }

    pub(super) fn text(&self, schemes: Schemes) -> String {
        let scheme = if self.encrypted { schemes.encrypted } else { schemes.clear };
        format!("{scheme}://{}", self.authority)
    }

    fn uri(&self) -> String {
        let scheme = if self.encrypted { "wss" } else { "ws" };
        format!("{scheme}://{}/", self.authority)
    }
}

/// Time since which no connection to a server was lost, ms since 1970; `None` while there is
/// no such connection. Servers that name no checkpoint may have been replaced in between.
#[derive(Clone, Default)]
struct ConnectedSince(Arc<Mutex<Option<u64>>>);

impl ConnectedSince {
    fn lock(&self) -> MutexGuard<'_, Option<u64>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

pub(super) struct Server {
    connected: ConnectedSince,
    host_port: HostPort,
    access: Access,
    peer: Peer,
    /// Scheme of the `Authorization` header, such as `Bearer`.
    authorization: &'static str,
}

impl Server {
    /// Creates a server without connecting. `clear` and `encrypted` are its URL prefixes, with
    /// `://`. Returns `None` if the address is not a valid URI.
    pub(super) fn new(
        host_port: HostPort,
        access: Access,
        kind: ServerKind,
        [clear, encrypted]: [&'static str; 2],
        authorization: &'static str,
    ) -> Option<Self> {
        let endpoint = Endpoint::from_shared(host_port.uri()).ok()?;
        let settings = Settings { clear, encrypted, ..SETTINGS };
        Some(Self {
            connected: ConnectedSince::default(),
            peer: Peer::new(&endpoint, kind, settings),
            host_port,
            access,
            authorization,
        })
    }

    pub(super) fn authority(&self) -> &str {
        &self.host_port.authority
    }

    pub(super) fn lost(&self) {
        *self.connected.lock() = None;
    }

    /// Returns the setting that tells results before a lost connection from those after it.
    pub(super) fn connected_since(&self) -> Setting {
        let since = *self.connected.lock();
        let value = since.map_or_else(String::new, |since| {
            let at = OffsetDateTime::UNIX_EPOCH + Duration::from_millis(since);
            let (h, m, s, ms) = at.to_hms_milli();
            format!(
                "{} since {}T{h:02}:{m:02}:{s:02}.{ms:03}Z",
                self.host_port.authority,
                at.date()
            )
        });
        Setting { name: CONNECTED_SINCE.to_owned(), value }
    }

    /// Connects, sends `first` if given, and waits for the server's first message.
    pub(super) async fn connect(
        &self,
        first: Option<Vec<u8>>,
    ) -> Result<(Connection, Received), BackendError> {
        let connecting = TcpStream::connect(&self.host_port.authority);
        let stream = match tokio::time::timeout(CONNECT_TIMEOUT, connecting).await {
            Ok(Ok(stream)) => stream,
            Ok(Err(error)) => return Err(self.unreachable(self.peer.explain(&error))),
            Err(late) => return Err(self.unreachable(self.peer.explain(&late))),
        };
        let checked = match self.host_port.uri().parse() {
            Ok(uri) => self.access.check_connection(&uri, &stream).await.map_err(Fault::Untrusted),
            Err(invalid) => Err(Fault::NoAnswer(InvalidUri::to_string(&invalid))),
        };
        checked.map_err(|fault| self.unreachable(self.peer.error(fault)))?;
        let greeting = async {
            let socket = match self.shake_hands(stream).await {
                Ok(socket) => socket,
                Err(error) => return Err(self.refusal(&error)),
            };
            let mut connection = Connection {
                socket,
                connected: self.connected.clone(),
                authority: self.host_port.authority.clone(),
                peer: self.peer.clone(),
            };
            self.connected.lock().get_or_insert_with(|| (now() * 1e3) as u64);
            if let Some(first) = first {
                connection.send(first).await?;
            }
            let received = connection.receive().await?;
            Ok((connection, received))
        };
        tokio::time::timeout(GREETING_TIMEOUT, greeting)
            .await
            .map_err(|late| self.unreachable(self.peer.explain(&late)))?
    }

    async fn shake_hands(
        &self,
        stream: TcpStream,
    ) -> Result<WebSocketStream<Box<dyn Stream>>, tungstenite::Error> {
        let mut request = self.host_port.uri().into_client_request()?;
        if let Some(token) = self.access.authorization(request.uri(), self.authorization) {
            request.headers_mut().insert(AUTHORIZATION, token);
        }
        stream.set_nodelay(true)?;
        let stream: Box<dyn Stream> = match self.host_port.encrypted {
            false => Box::new(stream),
            true => {
                let host = request.uri().host().unwrap_or_default();
                let host = host.trim_start_matches('[').trim_end_matches(']');
                Box::new(self.access.encrypt(stream, host).await?)
            }
        };
        let limits = WebSocketConfig::default()
            .max_message_size(Some(MAX_MESSAGE_BYTES))
            .max_frame_size(Some(MAX_MESSAGE_BYTES));
        let (socket, _) = client_async_with_config(request, stream, Some(limits)).await?;
        Ok(socket)
    }

    fn refusal(&self, error: &tungstenite::Error) -> BackendError {
        match error {
            tungstenite::Error::Http(response)
                if matches!(response.status().as_u16(), 401 | 403) =>
            {
                BackendError::TokenRejected {
                    address: self.host_port.authority.clone(),
                    reason: format!("it answered HTTP {}", response.status()),
                }
            }
            tungstenite::Error::Http(response) => {
                self.unreachable(self.peer.error(Fault::http(response.status().as_u16())))
            }
            tungstenite::Error::Protocol(ProtocolError::HttparseError(answer)) => {
                self.unreachable(self.peer.error(Fault::OtherProtocol(answer.to_string())))
            }
            error => self.unreachable(self.peer.explain(error)),
        }
    }

    fn unreachable(&self, trouble: ConnectError) -> BackendError {
        *self.connected.lock() = None;
        let address = self.host_port.authority.clone();
        BackendError::Unreachable { address, trouble: trouble.into() }
    }
}

#[allow(clippy::disallowed_methods, reason = "only a timestamp for logs and results")]
pub(super) fn now() -> f64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.unwrap_or_default().as_secs_f64()
}

trait Stream: AsyncRead + AsyncWrite + Send + Unpin {}
impl<S: AsyncRead + AsyncWrite + Send + Unpin> Stream for S {}

pub(super) enum Received {
    Binary(Vec<u8>),
    Text(String),
}

pub(super) struct Connection {
    socket: WebSocketStream<Box<dyn Stream>>,
    connected: ConnectedSince,
    authority: String,
    peer: Peer,
}

impl Connection {
    pub(super) async fn send(&mut self, message: Vec<u8>) -> Result<(), BackendError> {
        let sent = self.socket.send(Message::binary(message)).await;
        sent.map_err(|error| self.lost(&error))
    }

    pub(super) async fn receive(&mut self) -> Result<Received, BackendError> {
        loop {
            match self.socket.next().await {
                Some(Ok(Message::Binary(bytes))) => return Ok(Received::Binary(bytes.to_vec())),
                Some(Ok(Message::Text(text))) => return Ok(Received::Text(text.to_string())),
                // The library answers pings.
                Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => {}
                Some(Err(tungstenite::Error::Capacity(_))) => {
                    return Err(BackendError::Policy {
                        message: format!(
                            "it sent a message of more than {} MiB, but actions take only a few kB",
                            MAX_MESSAGE_BYTES >> 20
                        ),
                    });
                }
                Some(Err(error)) => return Err(self.lost(&error)),
                Some(Ok(Message::Close(_))) | None => {
                    return Err(self.lost(&tungstenite::Error::ConnectionClosed));
                }
            }
        }
    }

    /// Returns true if the server has neither closed the connection nor sent a message. Pings,
    /// which Python's servers send every 20 s, are answered.
    pub(super) fn is_idle(&mut self) -> bool {
        loop {
            match self.socket.next().now_or_never() {
                None => return true,
                Some(Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_)))) => {}
                Some(_) => return false,
            }
        }
    }

    /// Closes the connection; ignores errors.
    pub(super) async fn close(mut self) {
        let _ = self.socket.close(None).await;
    }

    fn lost(&self, error: &tungstenite::Error) -> BackendError {
        *self.connected.lock() = None;
        let address = self.authority.clone();
        BackendError::Unreachable { address, trouble: self.peer.explain(error).into() }
    }
}
