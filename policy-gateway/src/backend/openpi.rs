//! The back-end of openpi's own policy servers, unmodified: a π0.5 server that
//! speaks msgpack over WebSocket. Responsible for being what openpi's LIBERO
//! client is to it: what it shows of an observation, and how much of a chunk it
//! executes; and for the connections. [`frame`] turns and shrinks frames,
//! [`codec`] writes and reads messages.
//!
//! Such a server keeps nothing between queries, does not say which checkpoint it
//! serves, and draws its noise from one stream that no seed reaches. The
//! description says so.

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
use super::{
    Backend, BackendError,
    shown::{self, FRAME_SIDE},
    websocket::{Connection, Received, Server},
};
use crate::sessions::{MAX_SESSIONS, SessionTable};

mod address;
pub mod codec;
pub mod frame;

/// Characters of a server's traceback that are quoted: its end names the error.
const TOLD_CHARS: usize = 600;
/// Readings, end to end the eight numbers of its state.
const STATE: [StateField; 3] = [
    StateField::EefPos,
    StateField::EefAxisAngle,
    StateField::GripperPos,
];
/// Connections, and queries at the server, at once: it computes one after the
/// other, and meanwhile the next one travels.
pub const MAX_CONNECTIONS: usize = 2;

/// An openpi server.
pub struct OpenpiBackend {
    address: OpenpiAddress,
    server: Server,
    /// The instruction of every session: it goes with every query.
    prompts: Mutex<SessionTable<String>>,
    turns: Semaphore,
    /// Idle connections.
    idle: Mutex<Vec<Connection>>,
}

impl OpenpiBackend {
    /// A back-end that has not connected yet.
    ///
    /// # Errors
    /// If the address is invalid.
    pub fn new(address: OpenpiAddress, access: Access) -> Result<Self, OpenpiAddressError> {
        let schemes = ["ws://", "wss://"];
        // As openpi's client shows its key.
        let server = Server::new(
            address.place.clone(),
            access,
            ServerKind::Openpi,
            schemes,
            "Api-Key",
        );
        Ok(Self {
            server: server.ok_or_else(|| OpenpiAddressError {
                text: address.to_string(),
            })?,
            address,
            prompts: Mutex::new(SessionTable::new(MAX_SESSIONS)),
            turns: Semaphore::new(MAX_CONNECTIONS),
            idle: Mutex::default(),
        })
    }

    async fn turn(&self) -> Option<SemaphorePermit<'_>> {
        // Never closed.
        self.turns.acquire().await.ok()
    }

    /// Connects, and reads the metadata that such a server sends first.
    async fn connect(&self) -> Result<(Connection, Vec<u8>), BackendError> {
        let (connection, metadata) = self.server.connect(None).await?;
        Ok((connection, answered(metadata)?))
    }

    fn idle(&self) -> std::sync::MutexGuard<'_, Vec<Connection>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn prompts(&self) -> std::sync::MutexGuard<'_, SessionTable<String>> {
        self.prompts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Asks one question. A caller that stops waiting takes the connection along,
    /// so that no other gets its answer.
    async fn ask(&self, message: Vec<u8>) -> Result<Vec<u8>, BackendError> {
        let _turn = self.turn().await;
        let idle = self.idle().pop();
        if let Some(mut connection) = idle {
            match ask(&mut connection, message.clone()).await {
                // The server restarted since; it keeps nothing that could be lost.
                Err(BackendError::Unreachable { .. }) => self.idle().clear(),
                answer => return self.keep(connection, answer),
            }
        }
        let (mut connection, _) = self.connect().await?;
        let answer = ask(&mut connection, message).await;
        self.keep(connection, answer)
    }

    /// After an error the server closes the connection.
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
        let _turn = self.turn().await;
        // A new connection each time: only that shows whether it is the same
        // server still. The metadata are the first thing that it says.
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
        let wrong = |message| BackendError::Policy { message };
        let message = question(&request, &prompt).map_err(wrong)?;
        let answer = self.ask(message).await?;
        let chunk = codec::answer(&answer).map_err(|error| wrong(error.to_string()))?;
        first_actions(&chunk, self.address.execute).map_err(wrong)
    }
}

impl fmt::Display for OpenpiBackend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.address.fmt(f)
    }
}

async fn ask(connection: &mut Connection, message: Vec<u8>) -> Result<Vec<u8>, BackendError> {
    connection.send(message).await?;
    answered(connection.receive().await?)
}

/// Returns the answer's bytes. A server sends its exception as text, then
/// closes the connection.
fn answered(received: Received) -> Result<Vec<u8>, BackendError> {
    match received {
        Received::Binary(bytes) => Ok(bytes),
        Received::Text(traceback) => Err(BackendError::Policy {
            message: last_chars(&traceback),
        }),
    }
}

fn last_chars(text: &str) -> String {
    let text = text.trim();
    let skipped = text.chars().count().saturating_sub(TOLD_CHARS);
    text.chars().skip(skipped).collect()
}

/// Describes any such server. Its metadata are whatever its training
/// configuration says; replicas must say the same.
fn describe(address: &OpenpiAddress, metadata: &[u8]) -> DescribeResponse {
    let digest = Sha256::digest(metadata);
    let digest: String = digest[..8].iter().map(|it| format!("{it:02x}")).collect();
    DescribeResponse {
        protocol_version: proto::PROTOCOL_VERSION,
        name: "openpi".to_owned(),
        checkpoint: format!("not named by its server, whose metadata are sha256 {digest}…"),
        cameras: CAMERAS.map(shown::camera).into(),
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

/// An observation as openpi's LIBERO client shows it.
fn question(request: &InferRequest, prompt: &str) -> Result<Vec<u8>, String> {
    let observation = request.observation.as_ref();
    let frame = |camera: &str| {
        let frame = shown::frame(observation, camera)?;
        Ok::<_, String>(frame::prepare(&frame, FRAME_SIDE as usize))
    };
    let [position, rotation, fingers] = STATE;
    let mut state = vec![];
    state.extend(shown::reading::<3>(observation, position)?);
    state.extend(shown::reading::<3>(observation, rotation)?);
    state.extend(shown::reading::<2>(observation, fingers)?);
    let [scene, wrist] = CAMERAS;
    Ok(codec::observation(&codec::Shown {
        side: frame::SIDE,
        image: &frame(scene)?,
        wrist_image: &frame(wrist)?,
        state: &state,
        prompt,
    }))
}

/// The actions that are executed.
fn first_actions(chunk: &codec::Chunk, execute: u32) -> Result<InferResponse, String> {
    let [count, width] = chunk.shape;
    if count < execute as usize {
        return Err(format!(
            "it answered {count} actions, and {execute} are executed per query: write \
             ?execute={count} behind its address, or serve a checkpoint with longer chunks"
        ));
    }
    // Another width is refused, and named, where all answers are checked.
    let numbers = chunk.numbers[..execute as usize * width].to_vec();
    Ok(InferResponse {
        actions: numbers,
        action_width: u32::try_from(width).unwrap_or(u32::MAX),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_read_as_it_is_written() {
        for text in ["ws://gpu7:8000", "wss://[::1]:8000?execute=10"] {
            let address: OpenpiAddress = text.parse().expect(text);
            assert_eq!(address.to_string(), text);
        }
        let wrong = [
            "ws://gpu7",
            "ws://:8000",
            "http://gpu7:8000",
            "ws://gpu7:8000/path",
            "ws://gpu7:8000?execute=0",
            "ws://gpu7:8000?run=5",
        ];
        for text in wrong {
            let error = text.parse::<OpenpiAddress>().expect_err(text);
            assert!(error.to_string().contains("ws://HOST:PORT"), "{error}");
        }
    }

    #[test]
    fn only_the_first_actions_of_a_chunk_are_handed_on() {
        let chunk = codec::Chunk {
            shape: [10, 7],
            numbers: (0..70_u8).map(f32::from).collect(),
        };
        let response = first_actions(&chunk, 5).expect("enough actions");
        assert_eq!(response.actions, chunk.numbers[..35]);
        let error = first_actions(&chunk, 11).expect_err("too few");
        assert!(error.contains("?execute=10"), "{error}");
    }
}
