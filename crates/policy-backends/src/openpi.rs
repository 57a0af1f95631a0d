//! Back-end of unmodified openpi policy servers, for example of π0.5. Their protocol is msgpack
//! over WebSocket. Acts like openpi's LIBERO client: sends the same part of an observation, and
//! executes the same number of actions of a chunk. Also manages the connections. [`frame`] resizes
//! frames, [`codec`] encodes and decodes messages.
//!
//! Such a server keeps no state between queries, does not name its checkpoint, and draws its noise
//! from a single stream that cannot be seeded. The description declares all three, and since when
//! no connection was lost.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use benchmark::attempt::UNNAMED_CHECKPOINT;
use proto::checks::CAMERAS;
use proto::policy::{
    DescribeResponse, InferRequest, InferResponse, Language, ResetRequest, Setting,
};
use sha2::{Digest, Sha256};
use tokio::sync::{Semaphore, SemaphorePermit};
use transport::{Access, ServerKind};

pub use self::address::{OPTIONS, OpenpiAddress, OpenpiAddressError, State};
use crate::backend::{Backend, BackendError};
use crate::observations::{self, FRAME_SIDE};
use crate::sessions::{MAX_SESSIONS, SessionTable};
use crate::spec::{Answers, BackendSpec, Kind, OwnError, Specified};
use crate::websocket::{Connection, Received, Server};

mod address;
pub mod codec;
pub mod frame;

/// Longest quoted part of a server's traceback, characters: the end, which names the error.
const QUOTED_CHARS: usize = 600;
/// Connections, and concurrent queries, per server: the server computes one query while the next
/// one is in transit.
pub const MAX_CONNECTIONS: usize = 2;

pub(crate) const KIND: Kind = Kind {
    answers: Some(Answers {
        read: |message| first_actions(&codec::answer(message).ok()?, 1).ok(),
        example: b"\x81\xa7actions\x84\xc4\x0b__ndarray__\xc3\xc4\x04data\xc4\x1c\
            \0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\
            \xc4\x05dtype\xa3<f4\xc4\x05shape\x92\x01\x07",
    }),
    ..Kind::new::<OpenpiAddress>(
        &["ws", "wss"],
        "ws://HOST:PORT[?NAME=VALUE&…] (an openpi server; wss:// over TLS)",
    )
};

impl Specified for OpenpiAddress {
    fn open(&self, access: &Access) -> Result<Arc<dyn Backend>, OwnError> {
        Ok(Arc::new(OpenpiBackend::new(self.clone(), access.clone())?))
    }

    fn is_encrypted(&self) -> bool {
        self.host_port.encrypted
    }

    fn corrected(&self, error: &str) -> Option<BackendSpec> {
        self.with_key_of(error).map(BackendSpec::new)
    }
}

pub struct OpenpiBackend {
    address: OpenpiAddress,
    server: Server,
    /// Instruction of every session, which is sent with every query.
    prompts: Mutex<SessionTable<String>>,
    permits: Semaphore,
    idle: Mutex<Vec<Connection>>,
}

impl OpenpiBackend {
    /// Creates a back-end without connecting.
    pub fn new(address: OpenpiAddress, access: Access) -> Result<Self, OpenpiAddressError> {
        let schemes = ["ws://", "wss://"];
        let kind = ServerKind::Other("the openpi server");
        // openpi's client sends its key as `Authorization: Api-Key`.
        let server = Server::new(address.host_port.clone(), access, kind, schemes, "Api-Key");
        Ok(Self {
            server: server.ok_or_else(|| OpenpiAddressError { text: address.to_string() })?,
            address,
            prompts: Mutex::new(SessionTable::new(MAX_SESSIONS)),
            permits: Semaphore::new(MAX_CONNECTIONS),
            idle: Mutex::default(),
        })
    }

    async fn permit(&self) -> Option<SemaphorePermit<'_>> {
        // The semaphore is never closed.
        self.permits.acquire().await.ok()
    }

    async fn connect(&self) -> Result<(Connection, Vec<u8>), BackendError> {
        // A server that has closed all connections has restarted.
        let mut idle = std::mem::take(&mut *self.idle());
        let had_open = !idle.is_empty();
        idle.retain_mut(Connection::is_idle);
        if had_open && idle.is_empty() {
            self.server.lost();
        }
        self.idle().append(&mut idle);
        let (connection, metadata) = self.server.connect(None).await?;
        Ok((connection, answer_bytes(metadata)?))
    }

    fn idle(&self) -> std::sync::MutexGuard<'_, Vec<Connection>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn prompts(&self) -> std::sync::MutexGuard<'_, SessionTable<String>> {
        self.prompts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// If the caller stops waiting, the connection is dropped, so that no other caller gets its
    /// answer.
    async fn send_query(&self, message: Vec<u8>) -> Result<Vec<u8>, BackendError> {
        let _permit = self.permit().await;
        let idle = self.idle().pop();
        if let Some(mut connection) = idle {
            match exchange(&mut connection, message.clone()).await {
                // The server has restarted since the connection's last use; it keeps no state that
                // could be lost.
                Err(BackendError::Unreachable { .. }) => self.idle().clear(),
                answer => return self.keep(connection, answer),
            }
        }
        let (mut connection, _) = self.connect().await?;
        let answer = exchange(&mut connection, message).await;
        self.keep(connection, answer)
    }

    /// Keeps a connection for reuse, unless an error occurred, after which the server closes it.
    fn keep<T>(
        &self,
        connection: Connection,
        answer: Result<T, BackendError>,
    ) -> Result<T, BackendError> {
        if answer.is_ok() {
            self.idle().push(connection);
        }
        answer
    }
}

#[tonic::async_trait]
impl Backend for OpenpiBackend {
    async fn describe(&self, _suite: &str) -> Result<DescribeResponse, BackendError> {
        let _permit = self.permit().await;
        // Opens a new connection each time, because a server sends its metadata only at the start
        // of a connection; the metadata show whether it is still the same server.
        let (connection, metadata) = self.connect().await?;
        let described = describe(&self.address, &metadata, self.server.connected_since());
        let mut idle = self.idle();
        idle.truncate(MAX_CONNECTIONS - 1);
        idle.push(connection);
        Ok(described)
    }

    async fn reset(&self, request: ResetRequest) -> Result<(), BackendError> {
        self.prompts().open(&request.session, request.instruction);
        Ok(())
    }

    async fn end(&self, session: &str) {
        self.prompts().close(session);
    }

    async fn infer(&self, request: InferRequest) -> Result<InferResponse, BackendError> {
        let prompt = self.prompts().get(&request.session).cloned();
        let prompt = prompt.ok_or(BackendError::SessionLost)?;
        let failed = |message| BackendError::Policy { message };
        let message = encode_query(&self.address, &request, &prompt).map_err(failed)?;
        let answer = self.send_query(message).await.map_err(|error| match error {
            BackendError::Policy { message } => failed(with_remedy(&self.address, message)),
            error => error,
        })?;
        let chunk = codec::answer(&answer).map_err(|error| failed(error.to_string()))?;
        let answer = first_actions(&chunk, self.address.execute).map_err(failed)?;
        Ok(with_gripper(answer, self.address.gripper))
    }
}

impl fmt::Display for OpenpiBackend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.address.fmt(f)
    }
}

async fn exchange(connection: &mut Connection, message: Vec<u8>) -> Result<Vec<u8>, BackendError> {
    connection.send(message).await?;
    answer_bytes(connection.receive().await?)
}

/// Returns the answer's bytes. A server that raised an exception sends it as text and closes the
/// connection.
fn answer_bytes(received: Received) -> Result<Vec<u8>, BackendError> {
    match received {
        Received::Binary(bytes) => Ok(bytes),
        Received::Text(traceback) => Err(BackendError::Policy { message: last_chars(&traceback) }),
    }
}

/// Adds the address to write, if a server's error asks for another key of an input.
fn with_remedy(address: &OpenpiAddress, traceback: String) -> String {
    match address.with_key_of(&traceback) {
        Some(found) => format!("{traceback}; if that key is an input, write {found} as its route"),
        None => traceback,
    }
}

fn last_chars(text: &str) -> String {
    let text = text.trim();
    let skipped = text.chars().count().saturating_sub(QUOTED_CHARS);
    text.chars().skip(skipped).collect()
}

/// Describes an openpi server. Its metadata depend on its training configuration, and must be the
/// same for all replicas.
fn describe(address: &OpenpiAddress, metadata: &[u8], connected: Setting) -> DescribeResponse {
    let digest = hex::encode(&Sha256::digest(metadata)[..8]);
    DescribeResponse {
        protocol_version: proto::PROTOCOL_VERSION,
        name: "openpi".to_owned(),
        checkpoint: match address.checkpoint.as_str() {
            "" => format!("{UNNAMED_CHECKPOINT}, whose metadata are sha256 {digest}…"),
            name => format!("{name}, as its route names it"),
        },
        cameras: cameras(address).map(|(camera, _)| observations::camera(camera)).collect(),
        state: address.state.fields().iter().map(|&field| field.into()).collect(),
        horizon: address.execute,
        execute: address.execute,
        stochastic: true,
        unseeded: true,
        language: Language::FreeForm.into(),
        settings: settings(address).into_iter().chain([connected]).collect(),
        ..DescribeResponse::default()
    }
}

/// Returns the settings that an address fixes: the cameras of the image slots, and every other
/// option that is not openpi's.
fn settings(address: &OpenpiAddress) -> Vec<Setting> {
    let slots = cameras(address).map(|(camera, key)| format!("{key}={camera}"));
    let slots = slots.collect::<Vec<_>>().join(", ");
    let options = address.options().into_iter();
    // The description has its own fields for these.
    let is_setting = |(name, _): &(&str, String)| {
        !["execute", "image_key", "wrist_key", "checkpoint"].contains(name)
    };
    let options = options.filter(is_setting).map(|(name, value)| (name.to_owned(), value));
    let all = [("image slots".to_owned(), slots)].into_iter().chain(options);
    all.map(|(name, value)| Setting { name, value }).collect()
}

/// Returns the cameras whose frames the server gets, each with its key.
fn cameras(address: &OpenpiAddress) -> impl Iterator<Item = (&'static str, &str)> {
    let keys = [Some(address.image_key.as_str()), address.wrist_key()];
    CAMERAS.into_iter().zip(keys).filter_map(|(camera, key)| Some((camera, key?)))
}

/// Encodes an observation as openpi's LIBERO client does.
fn encode_query(
    address: &OpenpiAddress,
    request: &InferRequest,
    prompt: &str,
) -> Result<Vec<u8>, String> {
    let observation = request.observation.as_ref();
    let side = address.size as usize;
    let images = cameras(address).map(|(camera, key)| {
        let turned = observations::frame(observation, camera)?;
        let frame = if address.is_turned { turned } else { observations::rotated(&turned) };
        Ok((key, frame::resize(&frame, [FRAME_SIDE as usize; 2], [side; 2])))
    });
    let mut state = vec![];
    for &field in address.state.fields() {
        state.extend(observations::numbers(observation, field)?);
    }
    Ok(codec::observation(&codec::ClientObservation {
        side,
        images: &images.collect::<Result<Vec<_>, String>>()?,
        state: (address.state != State::None).then_some((&address.state_key, &state)),
        prompt: (&address.prompt_key, prompt),
    }))
}

/// Converts the server's numbers for the gripper to LIBERO's, where −1 is open and 1 is closed.
fn with_gripper(mut answer: InferResponse, gripper: [i32; 2]) -> InferResponse {
    let width = answer.action_width as usize;
    if width > 0 && gripper != [-1, 1] {
        let [open, closed] = gripper.map(|number| number as f32);
        for gripper in answer.actions.iter_mut().skip(width - 1).step_by(width) {
            *gripper = 2.0 * (*gripper - open) / (closed - open) - 1.0;
        }
    }
    answer
}

fn first_actions(chunk: &codec::Chunk, execute: u32) -> Result<InferResponse, String> {
    let [count, width] = chunk.shape;
    if count == 0 {
        return Err(format!(
            "it answered an empty chunk: serve a checkpoint with chunks of {execute} or more \
             actions"
        ));
    }
    if count < execute as usize {
        return Err(format!(
            "it answered {count} actions, and {execute} are executed per query: write \
             ?execute={count} after its address, or serve a checkpoint with longer chunks"
        ));
    }
    // The gateway's checks refuse an invalid width.
    let numbers = chunk.numbers[..execute as usize * width].to_vec();
    Ok(InferResponse { actions: numbers, action_width: u32::try_from(width).unwrap_or(u32::MAX) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_servers_gripper_becomes_liberos() {
        for (gripper, expected) in [([-1, 1], 0.5), ([1, 0], 0.0), ([0, 2], -0.5)] {
            let answer = InferResponse { actions: vec![0.5; 14], action_width: 7 };
            let actions = with_gripper(answer, gripper).actions;
            assert_eq!((actions[5], actions[6], actions[13]), (0.5, expected, expected));
        }
    }

    #[test]
    fn only_the_executed_actions_of_a_chunk_are_returned() {
        let chunk = codec::Chunk { shape: [10, 7], numbers: (0..70_u8).map(f32::from).collect() };
        let response = first_actions(&chunk, 5).expect("enough actions");
        assert_eq!(response.actions, chunk.numbers[..35]);
        let error = first_actions(&chunk, 11).expect_err("too few");
        assert!(error.contains("?execute=10"), "{error}");
    }

    #[test]
    fn an_empty_chunk_is_refused_without_advice_about_execute() {
        let chunk = codec::Chunk { shape: [0, 7], numbers: vec![] };
        let error = first_actions(&chunk, 5).expect_err("no actions");
        assert!(error.contains("chunks of 5 or more"), "{error}");
        assert!(!error.contains("?execute"), "{error}");
    }
}
