//! `worker film`: makes videos of rollouts that are over, from the actions that
//! their campaign kept, until none is left to film. It asks no policy, and takes
//! no rollout from anybody.

use std::io;
use std::ops::ControlFlow;
use std::path::Path;

use proto::coordinator::{Film, LeaseRef, NextFilmRequest};
use protocol::{ManifestRow, Realisation};
use sim::Simulator;
use tokio::sync::watch;
use tonic::Status;
use transport::Access;

use crate::grpc::in_words;
use crate::policy::{ACTION_WIDTH, Action};
use crate::recording::{Take, record};
use crate::rollout::{Stage, chain};
use crate::supervise::SuperviseError;
use crate::supervise::link::Link;

/// Bytes of a number on its way.
const NUMBER_BYTES: usize = 4;

/// Who films, and for whom.
#[derive(Debug)]
pub struct Config {
    /// URL of the coordinator.
    pub coordinator: String,
    /// How to get in there.
    pub access: Access,
    /// The asset pack's digest.
    pub asset_pack_digest: String,
    /// Jitters how often a silent coordinator is asked again.
    pub seed: u64,
}

/// What came of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Filmed {
    /// Videos that the coordinator has now.
    pub stored: u64,
    /// Rollouts of which there is none; the log says why.
    pub failed: u64,
}

/// Why nothing is filmed.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// The runtime or the scratch folder cannot be made.
    #[error("make room for videos")]
    Room(#[source] io::Error),
    /// The coordinator cannot be called.
    #[error(transparent)]
    Link(#[from] SuperviseError),
    /// It says no.
    #[error("ask the coordinator what to film: {}", in_words(.0))]
    Refused(Status),
}

/// A rollout to film, as it was handed out.
struct Order {
    lease: LeaseRef,
    /// What it is, for people.
    label: String,
    row: ManifestRow,
    realisation: Realisation,
    actions: Vec<Action>,
    success: bool,
}

/// Films until nothing is left.
///
/// # Errors
/// If the coordinator cannot be asked. A rollout that cannot be filmed is told
/// of in the log and counted.
pub fn run(config: &Config, simulator: &mut Simulator) -> Result<Filmed, FilmError> {
    let runtime = tokio::runtime::Runtime::new().map_err(FilmError::Room)?;
    let scratch = tempfile::tempdir().map_err(FilmError::Room)?;
    let file = scratch.path().join("video.mp4");
    // It never drains: whoever ends it loses one video.
    let (_running, draining) = watch::channel(false);
    let _inside = runtime.enter();
    let link = Link::new(&config.coordinator, &config.access, config.seed, draining)?;
    let mut filmed = Filmed::default();
    loop {
        let request = NextFilmRequest {
            asset_pack_digest: config.asset_pack_digest.clone(),
            mujoco_version: Simulator::mujoco_version(),
        };
        let answer = runtime.block_on(link.next_film(request));
        let answer = answer.map_err(FilmError::Refused)?;
        let Some(film) = answer.film else {
            return Ok(filmed);
        };
        let job = film.lease.as_ref().map_or(0, |lease| lease.job_id);
        let title = format!("job {job} of campaign {}", film.campaign);
        let done = order(film)
            .map_err(|problem| format!("read {title}: {problem}"))
            .and_then(|order| {
                tracing::info!("filming {} ({} left)", order.label, answer.left);
                shoot(simulator, &order, &file).map(|()| order)
            })
            .and_then(|order| {
                let stored = runtime.block_on(link.put_video(order.lease, &file));
                stored.map_err(|status| format!("store the video: {}", in_words(&status)))
            });
        match done {
            Ok(_) => filmed.stored += 1,
            Err(problem) => {
                filmed.failed += 1;
                tracing::warn!("no video of {title}: failed to {problem}");
            }
        }
    }
}

/// The error reads after "failed to …".
fn shoot(simulator: &mut Simulator, order: &Order, file: &Path) -> Result<(), String> {
    let take = Take {
        row: &order.row,
        realisation: order.realisation,
        actions: &order.actions,
        success: order.success,
    };
    let mut stage = Stage::of_the_protocol(simulator);
    let filmed = record(&mut stage, take, file, &mut |_| ControlFlow::Continue(()));
    filmed.map_err(|error| chain(&error))
}

fn order(film: Film) -> Result<Order, String> {
    let row: ManifestRow =
        serde_json::from_str(&film.manifest_row).map_err(|error| error.to_string())?;
    let realisation = film.realisation.parse();
    Ok(Order {
        lease: film.lease.ok_or("it names no lease")?,
        label: format!("{} {}#r{}", film.campaign, row.id, film.replicate),
        row,
        realisation: realisation.map_err(|error: protocol::UnknownName| error.to_string())?,
        actions: actions(&film.actions),
        success: film.success,
    })
}

/// Actions as they were sent with an outcome.
fn actions(bytes: &[u8]) -> Vec<Action> {
    let (numbers, _) = bytes.as_chunks::<NUMBER_BYTES>();
    let numbers: Vec<f64> = numbers
        .iter()
        .map(|number| f32::from_le_bytes(*number).into())
        .collect();
    let (actions, _) = numbers.as_chunks::<ACTION_WIDTH>();
    actions.to_vec()
}
