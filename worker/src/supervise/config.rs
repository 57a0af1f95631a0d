//! Configuration of a worker, and the coordinator's requirements.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Duration;

use benchmark::TaskKey;
use benchmark::{Look, TaskRef};
use proto::COORDINATOR_PROTOCOL_VERSION;
use proto::coordinator::{RegisterRequest, RegisterResponse};
use transport::Access;

use crate::assets::Provider;
use crate::child::SlotProgram;
use crate::ids::WorkerId;

#[derive(Clone, Debug)]
pub struct Config {
    pub coordinator: String,
    pub access: Access,
    /// Identity under which the worker registers with the coordinator.
    pub identity: Identity,
    /// Number of slots, each with one rollout at a time.
    pub slots: usize,
    /// Command line of a slot's process.
    pub slot_program: SlotProgram,
    /// Provides the files of jobs; without a provider, the files are assumed to exist.
    pub provider: Option<Provider>,
    /// Tasks that the asset pack cannot show and the worker therefore does not claim.
    pub lacking_tasks: Vec<TaskRef>,
    /// Names of the other simulators that the slots can start.
    pub simulators: Vec<String>,
    /// Endpoint of the policies, which overrides the endpoints of the leases.
    pub policy_endpoint: Option<String>,
    /// Longest time to finish rollouts in flight after the worker is asked to end; `None` sets no
    /// limit.
    pub drain: Option<Duration>,
    /// Idle time after which the worker ends; `None` waits for work without end.
    pub idle: Option<Duration>,
    /// Folder for videos before their upload.
    pub scratch: PathBuf,
    /// Seed of the jitter in waits.
    pub seed: u64,
}

/// Identity of a worker and its software, sent with the registration and in part with every result.
#[derive(Clone, Debug)]
pub struct Identity {
    /// Identifier of the worker, new at every start.
    pub worker: WorkerId,
    /// The machine's name.
    pub host: String,
    /// Identifier of the machine; empty if unknown.
    pub machine: String,
    pub asset_pack: String,
    /// SHA-256 of the asset pack, hex.
    pub asset_pack_digest: String,
    pub mujoco_version: String,
    pub look: Look,
}

impl Config {
    /// Returns the keys of tasks whose files this worker lacks now. Task files that were fetched
    /// since the worker's start count as present.
    pub(super) fn lacking_keys(&self) -> BTreeSet<String> {
        let of_pack = self.lacking_tasks.iter();
        let of_pack = of_pack.flat_map(|task| TaskKey::of_task(*task));
        let absent = self.provider.iter().flat_map(Provider::missing_benchmarks);
        let keys = of_pack.chain(absent.flat_map(TaskKey::needing));
        keys.map(|key| key.to_string()).collect()
    }
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
        look: identity.look.to_string(),
    }
}

/// Returns the number of cores that this process and its slots may use; CPU affinity or a control
/// group's quota may leave fewer than the machine has. 0 if unknown.
fn cores() -> u32 {
    let cores = std::thread::available_parallelism();
    cores.map_or(0, |cores| u32::try_from(cores.get()).unwrap_or(u32::MAX))
}

/// The coordinator's time limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Timing {
    pub(super) heartbeat: Duration,
    /// Longest time without progress of a rollout or a video, after which its slot is killed.
    pub(super) progress_timeout: Duration,
}

/// Placeholder until the registration, before which no heartbeat is sent and no rollout runs.
pub(super) const TIMING_UNTIL_REGISTERED: Timing =
    Timing { heartbeat: Duration::from_secs(5), progress_timeout: Duration::from_secs(180) };

/// Bounds of the coordinator's settings, so that a faulty answer neither causes a flood of
/// heartbeats nor disables the timeouts.
const HEARTBEAT_SECS: (f64, f64) = (0.05, 60.0);
const PROGRESS_TIMEOUT_SECS: (f64, f64) = (0.1, 86_400.0);

impl From<&RegisterResponse> for Timing {
    fn from(answer: &RegisterResponse) -> Self {
        // `max` before `min` turns a NaN into the lower bound.
        let secs = |secs: f64, (least, most): (f64, f64)| {
            Duration::from_secs_f64(secs.max(least).min(most))
        };
        Self {
            heartbeat: secs(answer.heartbeat_secs, HEARTBEAT_SECS),
            progress_timeout: secs(answer.progress_timeout_secs, PROGRESS_TIMEOUT_SECS),
        }
    }
}
