//! `worker film`: makes the missing videos of finished rollouts from the actions that their
//! campaign stored. It queries no policy and leases no job.

use std::io;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use benchmark::attempt::{AttemptId, Motion};
use benchmark::{Look, ManifestRow, Realisation, TaskRef};
use proto::coordinator::{Film, NextFilmRequest};
use sim::{Simulator, SimulatorConfig};
use tokio::runtime::Handle;
use tokio::sync::watch;
use tonic::Status;
use transport::{Access, chain, status_text};

use crate::actor::Action;
use crate::filming::{Replay, film_again};
use crate::stage::Stage;
use crate::supervise::SuperviseError;
use crate::supervise::link::Link;

#[derive(Debug)]
pub struct Config {
    pub coordinator: String,
    pub access: Access,
    pub asset_pack_digest: String,
    pub look: Look,
    /// Campaign whose rollouts are filmed; all campaigns if `None`.
    pub campaign: Option<String>,
    /// Number of rollouts that are filmed in parallel.
    pub at_a_time: NonZeroUsize,
    /// Seed of the jitter in waits.
    pub seed: u64,
}

/// Numbers of rollouts that were filmed and that could not be filmed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FilmCounts {
    pub stored: u64,
    /// Rollouts that could not be filmed; the log says why.
    pub failed: u64,
}

/// Reason why filming stopped.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    #[error("start the threads that call the coordinator; raise `ulimit -u` and `ulimit -n`")]
    Threads(#[source] io::Error),
    #[error("create a temporary folder for videos")]
    Folder(#[source] io::Error),
    #[error(transparent)]
    Link(#[from] SuperviseError),
    #[error("request a rollout to film from the coordinator at {url}: {}", status_text(status))]
    Refused { url: String, status: Box<Status> },
}

struct Filmable {
    attempt: AttemptId,
    /// Name of the rollout in messages.
    label: String,
    row: ManifestRow,
    realisation: Realisation,
    actions: Vec<Action>,
    success: bool,
}

/// Films rollouts until none is left, in `config.at_a_time` threads, each with a simulator of its
/// own. `provide` fetches the files of a rollout's task if they are missing. A rollout that cannot
/// be filmed is logged and counted.
pub fn run(
    config: &Config,
    simulator: &SimulatorConfig,
    provide: &(dyn Fn(TaskRef) -> Result<(), String> + Sync),
) -> Result<FilmCounts, FilmError> {
    let runtime = tokio::runtime::Runtime::new().map_err(FilmError::Threads)?;
    let scratch = tempfile::tempdir().map_err(FilmError::Folder)?;
    // `worker film` never drains: when it is ended, unfinished videos are lost.
    let (_running, draining) = watch::channel(false);
    let runtime_context = runtime.enter();
    let link = Link::new(&config.coordinator, &config.access, config.seed, draining)?;
    drop(runtime_context);
    let filming = Filming { config, handle: runtime.handle(), link: &link, provide };
    let filmed = std::thread::scope(|scope| {
        let threads = (0..config.at_a_time.get()).map(|number| {
            let file = scratch.path().join(format!("video-{number}.mp4"));
            let (filming, simulator) = (&filming, simulator.clone());
            scope.spawn(move || filming.run(&mut Simulator::new(simulator), &file))
        });
        // The handles are collected first, so that all threads are started before the first thread
        // is joined.
        let threads: Vec<_> = threads.collect();
        let ended = threads
            .into_iter()
            .map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        ended.collect::<Result<Vec<FilmCounts>, FilmError>>()
    })?;
    Ok(filmed.into_iter().fold(FilmCounts::default(), |sum, filmed| FilmCounts {
        stored: sum.stored + filmed.stored,
        failed: sum.failed + filmed.failed,
    }))
}

/// State that the threads share.
struct Filming<'a> {
    config: &'a Config,
    handle: &'a Handle,
    link: &'a Link,
    provide: &'a (dyn Fn(TaskRef) -> Result<(), String> + Sync),
}

impl Filming<'_> {
    /// Films one rollout after the other. The coordinator gives each rollout to one caller only.
    fn run(&self, simulator: &mut Simulator, file: &Path) -> Result<FilmCounts, FilmError> {
        let mut filmed = FilmCounts::default();
        loop {
            let request = NextFilmRequest {
                asset_pack_digest: self.config.asset_pack_digest.clone(),
                mujoco_version: Simulator::mujoco_version(),
                look: self.config.look.to_string(),
                campaign: self.config.campaign.clone().unwrap_or_default(),
            };
            let answer = self.handle.block_on(self.link.next_film(request));
            let answer = answer.map_err(|status| FilmError::Refused {
                url: self.config.coordinator.clone(),
                status: status.into(),
            })?;
            let Some(film) = answer.film else {
                return Ok(filmed);
            };
            let title = format!("attempt {} of campaign {}", film.attempt_id, film.campaign);
            let began = Instant::now();
            let done = parse_film(film)
                .map_err(|problem| format!("read {title}: {problem}"))
                .and_then(|rollout| {
                    tracing::info!("filming {} ({} left)", rollout.label, answer.left);
                    (self.provide)(rollout.row.id.task())?;
                    film_rollout(simulator, &rollout, file).map(|()| rollout)
                })
                .and_then(|rollout| {
                    let stored = self.link.put_video(rollout.attempt, file);
                    let stored = self.handle.block_on(stored);
                    stored.map_err(|status| format!("store the video: {}", chain(&status)))?;
                    Ok(rollout)
                });
            match done {
                Ok(rollout) => {
                    filmed.stored += 1;
                    let secs = began.elapsed().as_secs_f64();
                    tracing::info!("filmed {} in {secs:.0} s", rollout.label);
                }
                Err(problem) => {
                    filmed.failed += 1;
                    tracing::warn!("no video of {title}: failed to {problem}");
                }
            }
        }
    }
}

/// Films a rollout to `file`. The error follows the words "failed to".
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

fn parse_film(film: Film) -> Result<Filmable, String> {
    let row: ManifestRow = serde_json::from_str(&film.manifest_row)
        .map_err(|error| benchmark::JsonError::from(error).to_string())?;
    let attempt = film.attempt_id.parse();
    let realisation = film.realisation.parse();
    let motion = Motion { actions: film.actions, ..Motion::default() };
    let actions = motion.actions().into_iter();
    Ok(Filmable {
        attempt: attempt.map_err(|error: benchmark::attempt::AttemptIdError| error.to_string())?,
        label: format!("{} {}#r{}", film.campaign, row.id, film.replicate),
        row,
        realisation: realisation.map_err(|error: benchmark::UnknownName| error.to_string())?,
        actions: actions.map(|action| action.map(f64::from)).collect(),
        success: film.success,
    })
}
