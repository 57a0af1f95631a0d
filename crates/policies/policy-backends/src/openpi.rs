//! Back-end of unmodified openpi policy servers, for example of π0.5. Their protocol is msgpack
//! over WebSocket. Acts like openpi's LIBERO client: sends the same part of an observation, and
//! executes the same number of actions of a chunk. Also manages the connections. [`frame`] resizes
//! frames, [`codec`] encodes and decodes messages.
//!
//! Such a server keeps no state between queries, does not name its checkpoint, and draws its noise
//! from a single stream that cannot be seeded. The description declares all three.

use std::{
    fmt,
    sync::{Mutex, PoisonError},
};

use policy_protocol::CAMERAS;
use proto::policy::{
    DescribeResponse, InferRequest, InferResponse, Language, ResetRequest, Setting, StateField,
};
use sha2::{Digest, Sha256};
use tokio::sync::{Semaphore, SemaphorePermit};
use transport::{Access, ServerKind};

pub use self::address::{DEFAULT_EXECUTE, MAX_EXECUTE, OpenpiAddress, OpenpiAddressError};
use crate::{
    backend::{Backend, BackendError},
    observations::{self, FRAME_SIDE},
    sessions::{MAX_SESSIONS, SessionTable},
    websocket::{Connection, Received, Server},
};

mod address;
pub mod codec;
pub mod frame;

/// Longest quoted part of a server's traceback, characters: the end, which names the error.
const QUOTED_CHARS: usize = 600;
/// Robot readings that form the eight numbers of the server's state, in order.
const STATE: [StateField; 3] =
    [StateField::EefPos, StateField::EefAxisAngle, StateField::GripperPos];
/// Connections, and concurrent queries, per server: the server computes one query while the next
/// one is in transit.
pub const MAX_CONNECTIONS: usize = 2;

/// Connection pool and sessions of an openpi server.
pub struct OpenpiBackend {
    address: OpenpiAddress,
    server: Server,
    /// Instruction of every session, which is sent with every query.
    prompts: Mutex<SessionTable<String>>,
    permits: Semaphore,
    /// Idle connections.
    idle: Mutex<Vec<Connection>>,
}

impl OpenpiBackend {
    /// Creates a back-end without connecting.
    ///
    /// # Errors
    /// If the address is invalid.
    pub fn new(address: OpenpiAddress, access: Access) -> Result<Self, OpenpiAddressError> {
        let schemes = ["ws://", "wss://"];
        // openpi's client sends its key with this scheme.
        let server =
            Server::new(address.host_port.clone(), access, ServerKind::Openpi, schemes, "Api-Key");
        Ok(Self {
            server: server.ok_or_else(|| OpenpiAddressError { text: address.to_string() })?,
            address,
            prompts: Mutex::new(SessionTable::new(MAX_SESSIONS)),
            permits: Semaphore::new(MAX_CONNECTIONS),
            idle: Mutex::default(),
        })
    }

    /// Waits until fewer than [`MAX_CONNECTIONS`] queries are under way.
    async fn permit(&self) -> Option<SemaphorePermit<'_>> {
        // The semaphore is never closed.
        self.permits.acquire().await.ok()
    }

    /// Connects, and reads the metadata that the server sends first.
    async fn connect(&self) -> Result<(Connection, Vec<u8>), BackendError> {
        let (connection, metadata) = self.server.connect(None).await?;
        Ok((connection, answer_bytes(metadata)?))
    }

    fn idle(&self) -> std::sync::MutexGuard<'_, Vec<Connection>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn prompts(&self) -> std::sync::MutexGuard<'_, SessionTable<String>> {
        self.prompts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends one query. If the caller stops waiting, the connection is dropped, so that no other
    /// caller gets its answer.
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
        let described = describe(&self.address, &metadata);
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
        let message = encode_query(&request, &prompt).map_err(failed)?;
        let answer = self.send_query(message).await?;
        let chunk = codec::answer(&answer).map_err(|error| failed(error.to_string()))?;
        first_actions(&chunk, self.address.execute).map_err(failed)
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

fn last_chars(text: &str) -> String {
    let text = text.trim();
    let skipped = text.chars().count().saturating_sub(QUOTED_CHARS);
    text.chars().skip(skipped).collect()
}

/// Describes an openpi server. Its metadata depend on its training configuration, and must be the
/// same for all replicas.
fn describe(address: &OpenpiAddress, metadata: &[u8]) -> DescribeResponse {
    let digest = Sha256::digest(metadata);
    let digest: String = digest[..8].iter().map(|byte| format!("{byte:02x}")).collect();
    DescribeResponse {
        protocol_version: proto::PROTOCOL_VERSION,
        name: "openpi".to_owned(),
        checkpoint: format!("not named by its server, whose metadata are sha256 {digest}…"),
        cameras: CAMERAS.map(observations::camera).into(),
        state: STATE.map(i32::from).into(),
        horizon: address.execute,
        execute: address.execute,
        stochastic: true,
        unseeded: true,
        language: Language::FreeForm.into(),
        settings: vec![Setting {
            name: "image slots".to_owned(),
            value: "observation/image=agentview, observation/wrist_image=robot0_eye_in_hand"
                .to_owned(),
        }],
        ..DescribeResponse::default()
    }
}

/// Encodes an observation as openpi's LIBERO client does.
fn encode_query(request: &InferRequest, prompt: &str) -> Result<Vec<u8>, String> {
    let observation = request.observation.as_ref();
    let frame = |camera: &str| {
        let frame = observations::frame(observation, camera)?;
        Ok::<_, String>(frame::prepare(&frame, FRAME_SIDE as usize))
    };
    let [position, rotation, fingers] = STATE;
    let mut state = vec![];
    state.extend(observations::reading::<3>(observation, position)?);
    state.extend(observations::reading::<3>(observation, rotation)?);
    state.extend(observations::reading::<2>(observation, fingers)?);
    let [scene, wrist] = CAMERAS;
    Ok(codec::observation(&codec::ClientObservation {
        side: frame::SIDE,
        image: &frame(scene)?,
        wrist_image: &frame(wrist)?,
        state: &state,
        prompt,
    }))
}

/// Returns the actions of a chunk that are executed.
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
    fn an_address_is_parsed_and_displayed_unchanged() {
        for text in ["ws://gpu7:8000", "wss://[::1]:8000?execute=10"] {
            let address: OpenpiAddress = text.parse().expect(text);
            assert_eq!(address.to_string(), text);
        }
        let invalid = [
            "ws://gpu7",
            "ws://:8000",
            "http://gpu7:8000",
            "ws://gpu7:8000/path",
            "ws://gpu7:8000?execute=0",
            "ws://gpu7:8000?run=5",
        ];
        for text in invalid {
            let error = text.parse::<OpenpiAddress>().expect_err(text);
            assert!(error.to_string().contains("ws://HOST:PORT"), "{error}");
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
