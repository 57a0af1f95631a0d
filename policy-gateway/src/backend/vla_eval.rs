//! The back-end of vla-eval's model servers, unmodified, which speak msgpack over
//! WebSocket. Responsible for being what vla-eval's LIBERO benchmark is to them:
//! the order of messages, what is shown of an observation, and what is done with
//! the actions; and for the connections. [`hello`] settles what is shown,
//! [`state`] and [`image`] compute it, [`message`] writes and reads.
//!
//! To such a server a connection is a session: it keeps chunks, histories and
//! ensembles by it. So every episode has a connection of its own, which ends with
//! it.

use std::{
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use proto::policy::{
    DescribeResponse, InferRequest, InferResponse, Observation, ResetRequest, StateField,
};
use rmpv::Value;
use transport::{Access, ServerKind};

pub use self::{
    address::{DEFAULT_EXECUTE, MAX_EXECUTE, Parameters, VlaEvalAddress, VlaEvalAddressError},
    image::ImageFormat,
    message::{AnswerError, answer},
};
use self::{
    hello::{CAMERAS, Terms},
    message::Kind,
};
use super::{
    Backend, BackendError,
    numpy::{Keys, array, map},
    shown::{self, FRAME_SIDE},
    websocket::{Connection, Received, Server},
};
use crate::sessions::SessionTable;

mod address;
mod hello;
mod image;
mod message;
mod state;

/// Episodes at one server at once, each of which has a connection; for one more
/// the one idle for longest is given up.
pub const MAX_EPISODES: usize = 512;
/// After so long without a query an episode has ended, if nobody said so before.
pub const ENDED_AFTER: Duration = Duration::from_secs(600);
/// Connections that are kept for episodes to come.
const MAX_IDLE: usize = 8;

/// A vla-eval model server.
pub struct VlaEvalBackend {
    address: VlaEvalAddress,
    server: Server,
    episodes: Mutex<SessionTable<Open>>,
    /// Connections that greeted and had no episode yet.
    idle: Mutex<Vec<Link>>,
}

struct Open {
    last_use: Instant,
    episode: Arc<Episode>,
}

struct Episode {
    instruction: String,
    /// None while a query is under way, and once the connection is lost. A caller
    /// that stops waiting takes it along, so that no later query gets its answer.
    link: tokio::sync::Mutex<Option<Link>>,
}

/// A connection and what was agreed on it.
struct Link {
    connection: Connection,
    terms: Terms,
    /// Messages sent.
    sent: u64,
    next_query: u32,
}

impl VlaEvalBackend {
    /// A back-end that has not connected yet.
    ///
    /// # Errors
    /// If the address is invalid.
    pub fn new(address: VlaEvalAddress, access: Access) -> Result<Self, VlaEvalAddressError> {
        let schemes = ["vla-eval://", "vla-evals://"];
        // The protocol has no tokens; what stands before a server may.
        let server = Server::new(
            address.place.clone(),
            access,
            ServerKind::VlaEval,
            schemes,
            "Bearer",
        );
        Ok(Self {
            server: server.ok_or_else(|| VlaEvalAddressError {
                text: address.to_string(),
            })?,
            address,
            episodes: Mutex::new(SessionTable::new(MAX_EPISODES)),
            idle: Mutex::default(),
        })
    }

    async fn connect(&self) -> Result<Link, BackendError> {
        let hello = message::message(Kind::Hello, message::hello(), 1, now());
        let (connection, received) = self.server.connect(Some(hello)).await?;
        Ok(Link {
            terms: self.terms(&received)?,
            connection,
            sent: 1,
            next_query: 0,
        })
    }

    fn terms(&self, received: &Received) -> Result<Terms, BackendError> {
        let hello = match received {
            Received::Binary(bytes) => message::greeting(bytes),
            Received::Text(_) => None,
        };
        let terms = match hello {
            Some(hello) => hello::terms(&hello.as_ref(), &self.address),
            None => Err(
                "it answered HELLO with something else; name the address of a vla-eval model \
                 server, or write ws://HOST:PORT for an openpi server"
                    .to_owned(),
            ),
        };
        terms.map_err(|reason| self.unsuited(reason))
    }

    fn unsuited(&self, reason: String) -> BackendError {
        BackendError::Unsuited {
            address: self.server.authority().to_owned(),
            reason,
        }
    }

    /// A connection that nobody has used.
    async fn fresh(&self) -> Result<Link, BackendError> {
        loop {
            let Some(mut link) = self.idle().pop() else {
                return self.connect().await;
            };
            // Else the server restarted since.
            if link.connection.is_idle() {
                return Ok(link);
            }
        }
    }

    fn idle(&self) -> MutexGuard<'_, Vec<Link>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn episodes(&self) -> MutexGuard<'_, SessionTable<Open>> {
        self.episodes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Link {
    async fn send(&mut self, kind: Kind, payload: Value) -> Result<(), BackendError> {
        self.sent += 1;
        let message = message::message(kind, payload, self.sent, now());
        self.connection.send(message).await
    }

    /// Asks one question.
    ///
    /// # Errors
    /// If the connection is lost.
    async fn ask(
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
        // A new connection each time: only that shows whether it is the same
        // server still.
        let link = self.connect().await?;
        let described = link.terms.described.clone();
        let mut idle = self.idle();
        idle.truncate(MAX_IDLE - 1);
        idle.push(link);
        Ok(described)
    }

    async fn reset(&self, request: ResetRequest) -> Result<(), BackendError> {
        let mut link = self.fresh().await?;
        let ResetRequest {
            session,
            suite,
            instruction,
            ..
        } = request;
        if let Some(its) = link.terms.suite.as_ref().filter(|its| **its != suite) {
            return Err(self.unsuited(format!(
                "it has a checkpoint for {its}, and the episode is of {suite}; give the policy a \
                 server per suite"
            )));
        }
        link.send(Kind::EpisodeStart, message::task(&suite, &instruction))
            .await?;
        let episode = Episode {
            instruction,
            link: Some(link).into(),
        };
        let open = Open {
            last_use: Instant::now(),
            episode: episode.into(),
        };
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
        // How it ended is not known here; where vla-eval does not know it either,
        // it says this.
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
        let mut place = episode.link.lock().await;
        let expected = place.as_ref().map(|link| link.next_query);
        if let Some(expected) = expected.filter(|it| *it != request.query_index) {
            return Err(BackendError::OutOfOrder { expected });
        }
        let mut link = place.take().ok_or(BackendError::SessionLost)?;
        let execute = self.address.execute;
        let format = self.address.image_format;
        let (terms, instruction) = (link.terms.clone(), episode.instruction.clone());
        // Milliseconds of compression.
        let shown = tokio::task::spawn_blocking(move || {
            observation(request.observation.as_ref(), &terms, format, &instruction)
        });
        let shown = shown.await.unwrap_or_else(|error| Err(error.to_string()));
        let wrong = |message| BackendError::Policy { message };
        let answer = match shown {
            Ok(shown) => link.ask(shown, execute).await?,
            Err(message) => {
                *place = Some(link);
                return Err(wrong(message));
            }
        };
        link.next_query += u32::from(answer.is_ok());
        if answer.as_ref().err().is_none_or(AnswerError::is_in_step) {
            *place = Some(link);
        }
        answer.map_err(|error| wrong(error.to_string()))
    }
}

impl fmt::Display for VlaEvalBackend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.address.fmt(f)
    }
}

/// An observation as vla-eval's LIBERO benchmark shows it.
fn observation(
    observation: Option<&Observation>,
    terms: &Terms,
    format: ImageFormat,
    instruction: &str,
) -> Result<Value, String> {
    let images = CAMERAS.iter().take(if terms.wrist { 2 } else { 1 });
    let images = images.map(|(camera, slot)| {
        let frame = shown::frame(observation, camera)?;
        let frame = image::encode(format, FRAME_SIDE, &frame);
        Ok((Value::from(*slot), frame.map_err(|it| it.to_string())?))
    });
    let images = Value::Map(images.collect::<Result<_, String>>()?);
    let entry = |key: &str, value| (Value::from(key), value);
    let mut entries = vec![
        entry("images", images),
        entry("task_description", instruction.into()),
    ];
    if terms.state {
        let position = shown::reading(observation, StateField::EefPos)?;
        let quaternion = shown::reading(observation, StateField::EefQuatXyzw)?;
        let hand = shown::reading(observation, StateField::EefRotation)?;
        let fingers = shown::reading(observation, StateField::GripperPos)?;
        let states = state::states(position, quaternion, fingers, terms.flips);
        let states = states.iter().flat_map(|it| it.to_le_bytes()).collect();
        let of_controller = state::controller_states(position, hand, fingers);
        let of_controller = of_controller.iter().flat_map(|it| it.to_le_bytes());
        entries.extend([
            entry("states", array(Keys::Text, "<f8", &[8], states)),
            entry(
                "controller_states",
                array(Keys::Text, "<f4", &[8], of_controller.collect()),
            ),
        ]);
    }
    Ok(Value::Map(entries))
}

/// Seconds since 1970.
#[allow(
    clippy::disallowed_methods,
    reason = "a stamp for the server's logs, which decides nothing"
)]
fn now() -> f64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.unwrap_or_default().as_secs_f64()
}
