//! The worker's parent process: leases jobs, hands them to its slots, keeps the
//! leases alive, delivers outcomes, and replaces slots that crash or hang. One
//! loop (`supervisor`) owns all state; tasks own single calls and single
//! processes, and tell the loop what came of them. Not responsible for simulating
//! anything: that is a slot's, in a process of its own.

mod deliver;
pub(crate) mod link;
pub(crate) mod memory;
pub(crate) mod process;
mod slot_state;
mod supervisor;

use std::path::PathBuf;
use std::time::Duration;

use proto::COORDINATOR_PROTOCOL_VERSION;
use proto::coordinator::{RegisterRequest, RegisterResponse};
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;
use transport::Access;

use crate::grpc::EndpointError;
use crate::ids::WorkerId;
use link::Link;
pub use process::SlotCommand;
use slot_state::MAX_FAILED_STARTS;
use supervisor::Supervisor;

/// Events that wait for the loop; whoever has another one waits too.
const EVENT_QUEUE: usize = 256;

/// What a worker is.
#[derive(Clone, Debug)]
pub struct Config {
    /// URL of the coordinator.
    pub coordinator: String,
    /// How to get in there.
    pub access: Access,
    /// Who it is to the coordinator.
    pub identity: Identity,
    /// Rollouts at a time.
    pub slots: usize,
    /// How a slot's process is started.
    pub slot_command: SlotCommand,
    /// Where policies are, whatever the leases say.
    pub policy_endpoint: Option<String>,
    /// A folder for videos on their way to the coordinator.
    pub scratch: PathBuf,
    /// Seed of the jitter in waits.
    pub seed: u64,
}

/// Who a worker is and what it runs on: goes with every result.
#[derive(Clone, Debug)]
pub struct Identity {
    /// New at every start.
    pub worker: WorkerId,
    /// The machine's name.
    pub host: String,
    /// The asset pack's name.
    pub asset_pack: String,
    /// SHA-256 of the asset pack, hex.
    pub asset_pack_digest: String,
    /// The simulator's version.
    pub mujoco_version: String,
}

/// Why a worker ended other than by being told to.
#[derive(Debug, thiserror::Error)]
pub enum SuperviseError {
    /// The coordinator's URL is none.
    #[error(transparent)]
    Endpoint(#[from] EndpointError),
    /// The certificate authority is no use.
    #[error("use the certificate authority for the coordinator")]
    Tls(#[source] tonic::transport::Error),
    /// The coordinator will not have this worker.
    #[error("register with the coordinator at {url}: {answer}")]
    Refused {
        /// Where it is.
        url: String,
        /// Why, in its words.
        answer: String,
    },
    /// The coordinator told this worker to stop.
    #[error("go on working: the coordinator stopped this worker because {0}")]
    Stopped(String),
    /// The slots would draw different pictures.
    #[error(
        "keep slot {slot}: it draws with `{renderer}` and this worker is registered with \
         `{registered}`; start one worker for each renderer"
    )]
    Renderers {
        /// Which slot, from 0.
        slot: usize,
        /// What draws there.
        renderer: String,
        /// What drew in the slot that was ready first.
        registered: String,
    },
    /// A slot's process does not survive its start.
    #[error(
        "keep slot {slot} running: its process ended {MAX_FAILED_STARTS} times in a row without \
         finishing a rollout; the last one {end}"
    )]
    Slot {
        /// Which slot, from 0.
        slot: usize,
        /// How it ended.
        end: String,
    },
}

/// Runs a worker until it is told to end, which takes as long as the rollouts
/// in hand. `shutdown` carries one message per request to end; the second one
/// gives the rollouts back instead.
///
/// # Errors
/// If the coordinator refuses the worker or stops it, or its slots cannot run.
pub async fn run(config: Config, shutdown: mpsc::Receiver<()>) -> Result<(), SuperviseError> {
    let (drain, draining) = watch::channel(false);
    let link = Link::new(&config.coordinator, &config.access, config.seed, draining)?;
    let (events, inbox) = mpsc::channel(EVENT_QUEUE);
    let supervisor = Supervisor::new(config, link, drain, events, Instant::now());
    supervisor.serve(inbox, shutdown).await
}

fn registration(config: &Config, renderer: String) -> RegisterRequest {
    let identity = config.identity.clone();
    RegisterRequest {
        protocol_version: COORDINATOR_PROTOCOL_VERSION,
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        worker_id: identity.worker.to_string(),
        host: identity.host,
        slots: u32::try_from(config.slots).unwrap_or(u32::MAX),
        asset_pack: identity.asset_pack,
        asset_pack_digest: identity.asset_pack_digest,
        mujoco_version: identity.mujoco_version,
        renderer,
    }
}

/// The coordinator's time limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Timing {
    heartbeat: Duration,
    progress_timeout: Duration,
}

/// Until the coordinator has said what it wants. Nothing is simulated by then.
const TIMING_UNTIL_REGISTERED: Timing = Timing {
    heartbeat: Duration::from_secs(5),
    progress_timeout: Duration::from_secs(180),
};

/// Bounds of what a coordinator may ask for, so that a nonsensical answer
/// neither floods it nor stops the clock.
const HEARTBEAT_SECS: (f64, f64) = (0.05, 60.0);
const PROGRESS_TIMEOUT_SECS: (f64, f64) = (0.1, 86_400.0);

impl From<&RegisterResponse> for Timing {
    fn from(answer: &RegisterResponse) -> Self {
        // `max` before `min`: a NaN becomes the lower bound.
        let secs = |secs: f64, (least, most): (f64, f64)| {
            Duration::from_secs_f64(secs.max(least).min(most))
        };
        Self {
            heartbeat: secs(answer.heartbeat_secs, HEARTBEAT_SECS),
            progress_timeout: secs(answer.progress_timeout_secs, PROGRESS_TIMEOUT_SECS),
        }
    }
}
