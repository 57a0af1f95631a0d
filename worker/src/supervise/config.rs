//! Configuration of a worker, and the coordinator's requirements.

use std::path::PathBuf;
use std::time::Duration;

use libero_ctrl::TaskRef;
use proto::COORDINATOR_PROTOCOL_VERSION;
use proto::coordinator::{RegisterRequest, RegisterResponse};
use transport::Access;

use crate::assets::Provider;
use crate::child::SlotProgram;
use crate::ids::WorkerId;

/// Configuration of a worker.
#[derive(Clone, Debug)]
pub struct Config {
    /// URL of the coordinator.
    pub coordinator: String,
    /// Credentials for the coordinator.
    pub access: Access,
    /// Identity under which it registers with the coordinator.
    pub identity: Identity,
    /// Rollouts at a time.
    pub slots: usize,
    /// Command line of a slot's process.
    pub slot_program: SlotProgram,
    /// Fetches what tasks need, for a pack whose files are fetched at first use.
    pub provider: Option<Provider>,
    /// Tasks that the asset pack cannot show, and that are not claimed.
    pub lacking_tasks: Vec<TaskRef>,
    /// Endpoint of the policies, which overrides that of the leases.
    pub policy_endpoint: Option<String>,
    /// Time that rollouts in flight may take once the worker is asked to end.
    pub drain: Option<Duration>,
    /// Time that the worker waits for work before it ends.
    pub idle: Option<Duration>,
    /// A folder for videos on their way to the coordinator.
    pub scratch: PathBuf,
    /// Seed of the jitter in waits.
    pub seed: u64,
}

/// A worker's id and what it runs on: goes with every result.
#[derive(Clone, Debug)]
pub struct Identity {
    /// New at every start.
    pub worker: WorkerId,
    /// The machine's name.
    pub host: String,
    /// Identifier of the machine; empty if there is none.
    pub machine: String,
    /// The asset pack's name.
    pub asset_pack: String,
    /// SHA-256 of the asset pack, hex.
    pub asset_pack_digest: String,
    /// The simulator's version.
    pub mujoco_version: String,
}

pub(super) fn registration(config: &Config, renderer: String) -> RegisterRequest {
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
        cores: cores(),
        machine: identity.machine,
    }
}

/// The cores that this process may use, which its slots share: fewer than the
/// machine's where its affinity or a control group's quota says so. 0 if the
/// machine does not say.
fn cores() -> u32 {
    let cores = std::thread::available_parallelism();
    cores.map_or(0, |cores| u32::try_from(cores.get()).unwrap_or(u32::MAX))
}

/// The coordinator's time limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Timing {
    pub(super) heartbeat: Duration,
    pub(super) progress_timeout: Duration,
}

/// Until the coordinator has said what it wants. Nothing is simulated by then.
pub(super) const TIMING_UNTIL_REGISTERED: Timing = Timing {
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
