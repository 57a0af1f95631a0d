//! `worker film`: makes videos of rollouts that are over, from the actions that
//! their campaign kept, until none is left to film. It asks no policy and
//! leases no job.

use std::io;
use std::ops::ControlFlow;
use std::path::Path;

use attempt::{AttemptId, Motion};
use proto::coordinator::{Film, NextFilmRequest};
use protocol::{ManifestRow, Realisation, TaskRef};
use sim::Simulator;
use tokio::sync::watch;
use tonic::Status;
use transport::{Access, answer, chain};

use crate::actor::Action;
use crate::filming::{Replay, film_again};
use crate::stage::Stage;
use crate::supervise::SuperviseError;
use crate::supervise::link::Link;

/// The coordinator whose rollouts are filmed, and what draws them.
#[derive(Debug)]
pub struct Config {
    /// URL of the coordinator.
    pub coordinator: String,
    /// How to get in there.
    pub access: Access,
    /// The asset pack's digest.
    pub asset_pack_digest: String,
    /// Seed of the jitter in waits.
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
    #[error("ask the coordinator at {url} what to film: {}", answer(status))]
    Refused {
        /// Where it is.
        url: String,
        /// Its answer.
        status: Box<Status>,
    },
}

/// A rollout to film.
struct Filmable {
    attempt: AttemptId,
    /// What it is, for people.
    label: String,
    row: ManifestRow,
    realisation: Realisation,
    actions: Vec<Action>,
    success: bool,
}

/// Films until nothing is left. `provide` sees that a task's files are there.
///
/// # Errors
/// If the coordinator cannot be reached. A rollout that cannot be filmed is
/// logged and counted.
pub fn run(
    config: &Config,
    simulator: &mut Simulator,
    provide: &mut dyn FnMut(TaskRef) -> Result<(), String>,
) -> Result<Filmed, FilmError> {
    let runtime = tokio::runtime::Runtime::new().map_err(FilmError::Room)?;
    let scratch = tempfile::tempdir().map_err(FilmError::Room)?;
    let file = scratch.path().join("video.mp4");
    // It never drains: ending it costs one video.
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
        let answer = answer.map_err(|status| FilmError::Refused {
            url: config.coordinator.clone(),
            status: status.into(),
        })?;
        let Some(film) = answer.film else {
            return Ok(filmed);
        };
        let title = format!("attempt {} of campaign {}", film.attempt_id, film.campaign);
        let done = filmable(film)
            .map_err(|problem| format!("read {title}: {problem}"))
            .and_then(|rollout| {
                tracing::info!("filming {} ({} left)", rollout.label, answer.left);
                provide(rollout.row.id.task())?;
                film_rollout(simulator, &rollout, &file).map(|()| rollout)
            })
            .and_then(|rollout| {
                let stored = runtime.block_on(link.put_video(rollout.attempt, &file));
                stored.map_err(|status| format!("store the video: {}", chain(&status)))
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
fn film_rollout(simulator: &mut Simulator, rollout: &Filmable, file: &Path) -> Result<(), String> {
    let replay = Replay {
        row: &rollout.row,
        realisation: rollout.realisation,
        actions: &rollout.actions,
        lifted_after: None,
        success: rollout.success,
    };
    let mut stage = Stage::of_the_protocol(simulator);
    let filmed = film_again(&mut stage, replay, file, &mut |_| ControlFlow::Continue(()));
    filmed.map_err(|error| chain(&error))
}

fn filmable(film: Film) -> Result<Filmable, String> {
    let row: ManifestRow = serde_json::from_str(&film.manifest_row)
        .map_err(|error| protocol::JsonError::from(error).to_string())?;
    let attempt = film.attempt_id.parse();
    let realisation = film.realisation.parse();
    let motion = Motion {
        actions: film.actions,
        ..Motion::default()
    };
    let actions = motion.actions().into_iter();
    Ok(Filmable {
        attempt: attempt.map_err(|error: attempt::AttemptIdError| error.to_string())?,
        label: format!("{} {}#r{}", film.campaign, row.id, film.replicate),
        row,
        realisation: realisation.map_err(|error: protocol::UnknownName| error.to_string())?,
        actions: actions.map(|action| action.map(f64::from)).collect(),
        success: film.success,
    })
}
