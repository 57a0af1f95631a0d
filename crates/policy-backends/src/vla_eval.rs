//! Back-end of unmodified vla-eval model servers, whose protocol is msgpack over WebSocket. Acts
//! like vla-eval's LIBERO benchmark in the order of messages, the observations sent, and the use of
//! the actions. Also manages the connections. `hello` negotiates the observations, `state` and
//! `image` compute them, `message` encodes and decodes.
//!
//! Such a server treats each connection as a session, and keeps the action chunks, histories and
//! ensembles of the session. So every episode has its own connection, which is closed when the
//! episode ends.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use proto::policy::{
    DescribeResponse, InferRequest, InferResponse, Observation, ResetRequest, StateField,
};
use rmpv::Value;
use transport::{Access, ServerKind};

pub use self::address::{
    DEFAULT_EXECUTE, MAX_EXECUTE, Parameters, VlaEvalAddress, VlaEvalAddressError,
};
use self::hello::{CAMERAS, Terms};
pub use self::image::ImageFormat;
use self::message::Kind;
pub use self::message::{AnswerError, answer};
use crate::backend::{Backend, BackendError};
use crate::numpy::{Keys, array, map};
use crate::observations::{self, FRAME_SIDE};
use crate::sessions::SessionTable;
use crate::spec::{Answers, Kind as BackendKind, OwnError, Specified};
use crate::websocket::{Connection, Received, Server, now};

mod address;
mod hello;
mod image;
mod message;
mod state;

pub(crate) const KIND: BackendKind = BackendKind {
    answers: Some(Answers {
        read: |message| answer(message, 1, 1).ok(),
        example: b"\x84\xa4type\xa6action\xa7payload\x81\xa7actions\
            \x84\xab__ndarray__\xc3\xa4data\xc4\x1c\
            \0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\
            \xa5dtype\xa3<f4\xa5shape\x91\x07\xa3seq\x01\xa9timestamp\x00",
    }),
    ..BackendKind::new::<VlaEvalAddress>(
        &["vla-eval", "vla-evals"],
        "vla-eval://HOST:PORT (a model server of vla-eval; vla-evals:// over TLS)",
    )
};

impl Specified for VlaEvalAddress {
    fn open(&self, access: &Access) -> Result<Arc<dyn Backend>, OwnError> {
        Ok(Arc::new(VlaEvalBackend::new(self.clone(), access.clone())?))
    }

    fn is_encrypted(&self) -> bool {
        self.host_port.encrypted
    }
}

/// Largest number of concurrent episodes per server, each with a connection; a further episode
/// replaces the episode that was idle for longest.
pub const MAX_EPISODES: usize = 512;
/// Time without a query after which an episode counts as ended.
pub const ENDED_AFTER: Duration = Duration::from_secs(600);
/// Idle connections kept for future episodes.
const MAX_IDLE: usize = 8;

pub struct VlaEvalBackend {
    address: VlaEvalAddress,
    server: Server,
    episodes: Mutex<SessionTable<OpenEpisode>>,
    /// Connections that have exchanged HELLO messages and have no episode yet.
    idle: Mutex<Vec<Link>>,
}

struct OpenEpisode {
    last_use: Instant,
    episode: Arc<Episode>,
}

struct Episode {
    instruction: String,
    /// `None` during a query, and after the connection is lost. A caller that stops waiting drops
    /// the connection, so that no later query gets its answer.
    link: tokio::sync::Mutex<Option<Link>>,
}

struct Link {
    connection: Connection,
    terms: Terms,
    sent: u64,
    next_query: u32,
}

impl VlaEvalBackend {
    /// Creates a back-end without connecting.
    pub fn new(address: VlaEvalAddress, access: Access) -> Result<Self, VlaEvalAddressError> {
        let schemes = ["vla-eval://", "vla-evals://"];
        let kind = ServerKind::Other("the vla-eval model server");
        // The protocol has no tokens, but a proxy in front of the server may require one.
        let server = Server::new(address.host_port.clone(), access, kind, schemes, "Bearer");
        Ok(Self {
            server: server.ok_or_else(|| VlaEvalAddressError { text: address.to_string() })?,
            address,
            episodes: Mutex::new(SessionTable::new(MAX_EPISODES)),
            idle: Mutex::default(),
        })
    }

    async fn connect(&self) -> Result<Link, BackendError> {
        let hello = message::message(Kind::Hello, message::hello(), 1, now());
        let (connection, received) = self.server.connect(Some(hello)).await?;
        Ok(Link { terms: self.terms(&received)?, connection, sent: 1, next_query: 0 })
    }

    fn terms(&self, received: &Received) -> Result<Terms, BackendError> {
        let hello = match received {
            Received::Binary(bytes) => message::hello_payload(bytes),
            Received::Text(_) => None,
        };
        let terms = match hello {
            Some(hello) => hello::terms(&hello.as_ref(), &self.address),
            None => {
                Err("it did not answer HELLO with a HELLO; name the address of a vla-eval model \
                 server, or write ws://HOST:PORT for an openpi server"
                    .to_owned())
            }
        };
        terms.map_err(|reason| self.unsupported(reason))
    }

    fn unsupported(&self, reason: String) -> BackendError {
        BackendError::UnsupportedPolicy { address: self.server.authority().to_owned(), reason }
    }

    async fn unused_link(&self) -> Result<Link, BackendError> {
        let mut was_closed = false;
        loop {
            let Some(mut link) = self.idle().pop() else {
                if was_closed {
                    self.server.lost();
                }
                return self.connect().await;
            };
            // A closed connection means that the server restarted.
            if link.connection.is_idle() {
                return Ok(link);
            }
            was_closed = true;
        }
    }

    fn idle(&self) -> MutexGuard<'_, Vec<Link>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn episodes(&self) -> MutexGuard<'_, SessionTable<OpenEpisode>> {
        self.episodes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Link {
    async fn send(&mut self, kind: Kind, payload: Value) -> Result<(), BackendError> {
        self.sent += 1;
        let message = message::message(kind, payload, self.sent, now());
        self.connection.send(message).await
    }

    /// Sends one query, and decodes the answer. The inner error is a fault of the answer.
    async fn send_query(
        &mut self,
        observation: Value,
        execute: u32,
    ) -> Result<Result<InferResponse, AnswerError>, BackendError> {
        self.send(Kind::Observation, observation).await?;
        let received = match self.connection.receive().await? {
            Received::Binary(bytes) => bytes,
            Received::Text(text) => text.into_bytes(),
        };
        Ok(message::answer(&received, self.sent, execute))
    }
}

#[tonic::async_trait]
impl Backend for VlaEvalBackend {
    async fn describe(&self, _suite: &str) -> Result<DescribeResponse, BackendError> {
        // Opens a new connection each time, because the HELLO shows whether the server is still
        // the same.
        let link = self.connect().await?;
        let mut described = link.terms.described.clone();
        described.settings.push(self.server.connected_since());
        let mut idle = self.idle();
        idle.truncate(MAX_IDLE - 1);
        idle.push(link);
        Ok(described)
    }

    async fn reset(&self, request: ResetRequest) -> Result<(), BackendError> {
        let mut link = self.unused_link().await?;
        let ResetRequest { session, suite, instruction, .. } = request;
        if let Some(served) = link.terms.suite.as_ref().filter(|served| **served != suite) {
            return Err(self.unsupported(format!(
                "it has a checkpoint for {served}, and the episode is of {suite}; give the policy \
                 a server per suite"
            )));
        }
        link.send(Kind::EpisodeStart, message::task(&suite, &instruction)).await?;
        let episode = Episode { instruction, link: Some(link).into() };
        let open = OpenEpisode { last_use: Instant::now(), episode: episode.into() };
        let mut episodes = self.episodes();
        episodes.retain(|open| open.last_use.elapsed() < ENDED_AFTER);
        episodes.open(&session, open);
        Ok(())
    }

    async fn end(&self, session: &str) {
        let Some(open) = self.episodes().close(session) else {
            return;
        };
        let link = open.episode.link.lock().await.take();
        let Some(mut link) = link else { return };
        // The outcome is unknown here; vla-eval sends an empty map in that case, too.
        if link.send(Kind::EpisodeEnd, map([])).await.is_ok() {
            link.connection.close().await;
        }
    }

    async fn infer(&self, request: InferRequest) -> Result<InferResponse, BackendError> {
        let episode = {
            let mut episodes = self.episodes();
            let open = episodes.get(&request.session);
            let open = open.ok_or(BackendError::SessionLost)?;
            open.last_use = Instant::now();
            Arc::clone(&open.episode)
        };
        let mut slot = episode.link.lock().await;
        let expected = slot.as_ref().map(|link| link.next_query);
        if let Some(expected) = expected.filter(|index| *index != request.query_index) {
            return Err(BackendError::OutOfOrder { expected });
        }
        let mut link = slot.take().ok_or(BackendError::SessionLost)?;
        let execute = self.address.execute;
        let format = self.address.image_format;
        let (terms, instruction) = (link.terms.clone(), episode.instruction.clone());
        // Compression takes milliseconds, so it runs on a blocking thread.
        let encoded = tokio::task::spawn_blocking(move || {
            observation(request.observation.as_ref(), &terms, format, &instruction)
        });
        let encoded = encoded.await.unwrap_or_else(|error| Err(error.to_string()));
        let failed = |message| BackendError::Policy { message };
        let answer = match encoded {
            Ok(encoded) => link.send_query(encoded, execute).await?,
            Err(message) => {
                *slot = Some(link);
                return Err(failed(message));
            }
        };
        link.next_query += u32::from(answer.is_ok());
        if answer.as_ref().err().is_none_or(AnswerError::is_synchronised) {
            *slot = Some(link);
        }
        answer.map_err(|error| failed(error.to_string()))
    }
}

impl fmt::Display for VlaEvalBackend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.address.fmt(f)
    }
}

/// Encodes an observation as vla-eval's LIBERO benchmark does.
fn observation(
    observation: Option<&Observation>,
    terms: &Terms,
    format: ImageFormat,
    instruction: &str,
) -> Result<Value, String> {
    let images = CAMERAS.iter().take(if terms.sends_wrist { 2 } else { 1 });
    let images = images.map(|(camera, slot)| {
        let frame = observations::frame(observation, camera)?;
        let frame = image::encode(format, FRAME_SIDE, &frame);
        Ok((Value::from(*slot), frame?))
    });
    let images = Value::Map(images.collect::<Result<_, String>>()?);
    let entry = |key: &str, value| (Value::from(key), value);
    let mut entries = vec![entry("images", images), entry("task_description", instruction.into())];
    if terms.sends_state {
        let position = observations::reading(observation, StateField::EefPos)?;
        let quaternion = observations::reading(observation, StateField::EefQuatXyzw)?;
        let hand = observations::reading(observation, StateField::EefRotation)?;
        let fingers = observations::reading(observation, StateField::GripperPos)?;
        let states = state::states(position, quaternion, fingers, terms.flips_quaternion);
        let states = states.iter().flat_map(|number| number.to_le_bytes()).collect();
        let controller_states = state::controller_states(position, hand, fingers);
        let controller_states = controller_states.iter().flat_map(|number| number.to_le_bytes());
        entries.extend([
            entry("states", array(Keys::Text, "<f8", &[8], states)),
            entry("controller_states", array(Keys::Text, "<f4", &[8], controller_states.collect())),
        ]);
    }
    Ok(Value::Map(entries))
}
