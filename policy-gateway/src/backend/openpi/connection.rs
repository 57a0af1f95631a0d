//! One WebSocket connection to an openpi server: it says its metadata first, and
//! then answers one message after the other.

use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::TcpStream,
};
use tokio_tungstenite::{
    WebSocketStream, client_async_with_config,
    tungstenite::{
        self, Message, client::IntoClientRequest, http::header::AUTHORIZATION,
        protocol::WebSocketConfig,
    },
};
use transport::{Access, Found, Peer};

use super::address::OpenpiAddress;
use crate::backend::{BackendError, grpc::CONNECT_TIMEOUT};

/// How long a server may take for handshake and greeting: it sends no greeting
/// while it computes.
const GREETING_WITHIN: Duration = Duration::from_secs(30);
/// Characters of a server's traceback that are quoted: its end names the error.
const TOLD_CHARS: usize = 600;

trait Stream: AsyncRead + AsyncWrite + Send + Unpin {}
impl<S: AsyncRead + AsyncWrite + Send + Unpin> Stream for S {}

pub(super) struct Connection {
    socket: WebSocketStream<Box<dyn Stream>>,
    authority: String,
    peer: Peer,
    metadata: Vec<u8>,
}

impl Connection {
    /// Connects, and reads what the server says first.
    pub(super) async fn open(
        address: &OpenpiAddress,
        access: &Access,
        peer: &Peer,
    ) -> Result<Self, BackendError> {
        let unreachable = |found| BackendError::Unreachable {
            address: address.authority.clone(),
            trouble: peer.found(found).into(),
        };
        let connecting = TcpStream::connect(&address.authority);
        let stream = match tokio::time::timeout(CONNECT_TIMEOUT, connecting).await {
            Ok(Ok(stream)) => stream,
            Ok(Err(_)) => return Err(absent(address, peer).await),
            Err(_) => return Err(unreachable(Found::NoAnswer)),
        };
        let greeting = async {
            let socket = match shake_hands(stream, address, access).await {
                Ok(socket) => socket,
                Err(error) => return Err(refusal(address, peer, &error).await),
            };
            let mut connection = Self {
                socket,
                authority: address.authority.clone(),
                peer: peer.clone(),
                metadata: vec![],
            };
            connection.metadata = connection.receive().await?;
            Ok(connection)
        };
        tokio::time::timeout(GREETING_WITHIN, greeting)
            .await
            .map_err(|_| unreachable(Found::Mute))?
    }

    /// What the server said first.
    pub(super) fn metadata(&self) -> &[u8] {
        &self.metadata
    }

    /// Sends a message and waits for its answer.
    pub(super) async fn ask(&mut self, message: Vec<u8>) -> Result<Vec<u8>, BackendError> {
        let sent = self.socket.send(Message::binary(message)).await;
        sent.map_err(|_| self.lost())?;
        self.receive().await
    }

    async fn receive(&mut self) -> Result<Vec<u8>, BackendError> {
        loop {
            match self.socket.next().await {
                Some(Ok(Message::Binary(bytes))) => return Ok(bytes.to_vec()),
                // What it raised while it answered; then it closes.
                Some(Ok(Message::Text(traceback))) => {
                    let message = last_chars(&traceback);
                    return Err(BackendError::Policy { message });
                }
                // The library answers pings.
                Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => {}
                Some(Ok(Message::Close(_))) | None => {
                    return Err(self.lost());
                }
                Some(Err(_)) => return Err(self.lost()),
            }
        }
    }

    fn lost(&self) -> BackendError {
        BackendError::Unreachable {
            address: self.authority.clone(),
            trouble: self.peer.found(Found::Broken).into(),
        }
    }
}

async fn shake_hands(
    stream: TcpStream,
    address: &OpenpiAddress,
    access: &Access,
) -> Result<WebSocketStream<Box<dyn Stream>>, tungstenite::Error> {
    let mut request = address.uri().into_client_request()?;
    // As openpi's client shows it.
    if let Some(key) = access.authorization(request.uri(), "Api-Key") {
        request.headers_mut().insert(AUTHORIZATION, key);
    }
    stream.set_nodelay(true)?;
    let stream: Box<dyn Stream> = match address.encrypted {
        false => Box::new(stream),
        true => {
            let host = request.uri().host().unwrap_or_default();
            let host = host.trim_start_matches('[').trim_end_matches(']');
            Box::new(access.encrypt(stream, host).await?)
        }
    };
    let limits = WebSocketConfig::default()
        .max_message_size(Some(proto::MAX_MESSAGE_BYTES))
        .max_frame_size(Some(proto::MAX_MESSAGE_BYTES));
    let (socket, _) = client_async_with_config(request, stream, Some(limits)).await?;
    Ok(socket)
}

async fn refusal(address: &OpenpiAddress, peer: &Peer, error: &tungstenite::Error) -> BackendError {
    match error {
        tungstenite::Error::Http(response) if matches!(response.status().as_u16(), 401 | 403) => {
            BackendError::Barred {
                address: address.authority.clone(),
                reason: format!("it answered HTTP {}", response.status()),
            }
        }
        tungstenite::Error::Http(response) => BackendError::Unreachable {
            address: address.authority.clone(),
            trouble: peer.found(Found::web(response.status().as_u16())).into(),
        },
        _ => absent(address, peer).await,
    }
}

/// What is there in the server's place.
async fn absent(address: &OpenpiAddress, peer: &Peer) -> BackendError {
    BackendError::Unreachable {
        address: address.authority.clone(),
        trouble: peer.look_around().await.into(),
    }
}

fn last_chars(text: &str) -> String {
    let text = text.trim();
    let skipped = text.chars().count().saturating_sub(TOLD_CHARS);
    text.chars().skip(skipped).collect()
}
