//! `worker rescue`: finds the last moment at which a failing rollout can still be saved. The scene
//! is brought to a step of the failing rollout by replaying its commands, the perturbations are
//! lifted there, and the policy continues in the nominal scene. The search finds the policy's last
//! query from which the policy still succeeds. At each step at which lifting saves the rollout, a
//! placebo is tried: nothing is lifted, and the robot is nudged by a thousandth of a millimetre. If
//! the placebo also saves the rollout, the outcome was marginal at that step, and the step does not
//! count as a rescue. Writes `rescue.json` and `rescue.mp4`, with the failed rollout on the left
//! and the saved rollout on the right.

mod search;
#[cfg(test)]
mod tests;

use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use crate::video::VideoEncoder;
use benchmark::attempt::Capsule;
use benchmark::{Condition, RolloutId};
use serde::Serialize;
use sim::episode::NUDGE_M;
use sim::{Episode, Observation, Simulator};

use crate::actor::{Action, Actor};
use crate::filming::{FilmingError, Replay, render_again};
use crate::message::{Assignment, Finished};
use crate::rollout::{self, Change, Resumed, RolloutError, Simulated, Step, Watcher};
use crate::stage::Stage;

use search::{Search, SearchResult};

/// Reason why the search failed.
#[derive(Debug, thiserror::Error)]
pub enum RescueError {
    #[error("rescue {0}: it has no perturbation to lift; name a failing rollout that has one")]
    NotPerturbed(RolloutId),
    #[error(
        "rescue {id}: it succeeds here after {steps} control steps; name a rollout that fails with \
         this policy and these assets"
    )]
    Succeeds { id: RolloutId, steps: u32 },
    #[error(
        "rescue {id}: the policy acts otherwise than in the capsule ({}); it must answer equal \
         queries equally, and run with the same assets",
        differences.join("; ")
    )]
    Differs { id: RolloutId, differences: Vec<String> },
    #[error(transparent)]
    Rollout(#[from] RolloutError),
    #[error("film the rescue")]
    Film(#[source] Box<dyn std::error::Error + Send + Sync>),
    #[error("write {}", path.display())]
    Write { path: PathBuf, source: std::io::Error },
}

/// Content of `rescue.json`. Steps are control steps of the policy, counted from 0.
#[derive(Debug, Serialize)]
pub struct Rescue {
    pub rollout_id: RolloutId,
    /// The policy's own name.
    pub policy: String,
    /// SHA-256 of the policy's checkpoint, if the policy gives it.
    pub policy_checkpoint_digest: String,
    pub max_steps: u32,
    /// Steps at which the policy was queried, the candidates of the search.
    pub looks: Vec<u32>,
    /// Trials, by step.
    pub tried: Vec<Tried>,
    /// Last tried step at which lifting the perturbations saves the rollout and the placebo does
    /// not; `None` if there is no such step.
    pub saved_until: Option<u32>,
    /// Step of the next query after `saved_until`, or of the first query if `saved_until` is
    /// `None`: there, the lift fails or the placebo also succeeds. `None` if `saved_until` is the
    /// last query.
    pub lost_from: Option<u32>,
    /// False if, at a tried step before `saved_until`, the lift failed or the placebo succeeded.
    pub is_monotone: bool,
    /// Steps at which the placebo also saves the rollout, whose outcome was marginal there.
    pub saved_by_placebo: Vec<u32>,
    /// Distance by which the placebo moves the robot's hand, m.
    pub nudge_m: f64,
}

#[derive(Clone, Copy, Debug, Serialize)]
pub struct Tried {
    /// Step at which the perturbations were lifted.
    pub lifted_at: u32,
    /// True if the policy then reached the goal.
    pub success: bool,
    /// Control steps of the whole rollout.
    pub steps: u32,
    /// Outcome of the placebo (nothing lifted, the robot nudged) at this step; `None` unless
    /// `success`.
    pub placebo_success: Option<bool>,
}

/// A failing rollout and a folder for the findings.
pub struct Request<'a> {
    pub assignment: &'a Assignment,
    /// The failing rollout as it ran in its campaign; a policy that acts otherwise is refused.
    pub capsule: Option<&'a Capsule>,
    /// True if the failed and the saved rollout are filmed.
    pub films: bool,
    pub output: &'a Path,
}

/// Finds the last query from which a failing rollout can be saved, and writes the findings.
///
/// The policy is reset at the step of the lift, so a policy with memory starts afresh.
pub fn run(
    simulator: &mut Simulator,
    actor: &mut dyn Actor,
    request: &Request<'_>,
) -> Result<Rescue, RescueError> {
    let Request { assignment, capsule, films, output } = *request;
    let id = assignment.row.id;
    if id.condition() == Condition::Nominal || id.condition().sets_execution() {
        return Err(RescueError::NotPerturbed(id));
    }
    let write = |path: &Path, source| RescueError::Write { path: path.to_owned(), source };
    fs::create_dir_all(output).map_err(|source| write(output, source))?;
    let mut stage = Stage::of_the_protocol(simulator);
    let mut query_steps = QuerySteps::default();
    tracing::info!("simulating {id} to its end, to check that it fails and to find its queries");
    let failed = rollout::run(&mut stage, actor, assignment, &mut query_steps)?;
    if failed.finished.result.success {
        let steps = failed.finished.result.steps;
        return Err(RescueError::Succeeds { id, steps });
    }
    let Finished { result, motion, .. } = &failed.finished;
    let differences = capsule.map_or_else(Vec::new, |capsule| capsule.differences(result, motion));
    if !differences.is_empty() {
        return Err(RescueError::Differs { id, differences });
    }
    let query_steps = query_steps.queried_at;
    tracing::info!(
        "{id} fails; the policy was queried at {}; searching for the last of them at which \
         lifting the perturbations saves the rollout",
        terminal::counted(query_steps.len() as u64, "step")
    );
    let mut search = Search::new(query_steps.len());
    let mut tried = Vec::new();
    let mut saved: Option<(usize, Simulated)> = None;
    while let Some(query) = search.next() {
        let step = query_steps[query] as usize;
        tracing::info!("try {}: lifting the perturbations at step {step}", tried.len() + 1);
        let mut resume = |change| {
            let resumed = Resumed { commands: &failed.actions[..step], change };
            let mut watcher = QuerySteps::default();
            rollout::run_resumed(Some(resumed), &mut stage, actor, assignment, &mut watcher)
        };
        let simulated = resume(Change::Lift)?;
        let result = &simulated.finished.result;
        tracing::info!("{id} lifted at step {step}: {}", outcome_word(result.success));
        let mut placebo_success = None;
        if result.success {
            let success = resume(Change::Nudge)?.finished.result.success;
            tracing::info!("{id} nudged at step {step}: {}", outcome_word(success));
            placebo_success = Some(success);
        }
        let is_saved = placebo_success == Some(false);
        search.record(query, is_saved);
        tried.push(Tried {
            lifted_at: query_steps[query],
            success: result.success,
            steps: result.steps,
            placebo_success,
        });
        if is_saved && saved.as_ref().is_none_or(|(best, _)| *best < step) {
            saved = Some((step, simulated));
        }
    }
    tried.sort_by_key(|trial| trial.lifted_at);
    if let Some((step, simulated)) = saved.as_ref().filter(|_| films) {
        tracing::info!("filming {id}, as it fails and as it is saved at step {step}");
        let film = side_by_side(&mut stage, assignment, &failed.actions, *step, simulated);
        let film = film.map_err(|error| RescueError::Film(Box::new(error)))?;
        let path = output.join("rescue.mp4");
        fs::write(&path, film).map_err(|source| write(&path, source))?;
    }
    let (saved, is_monotone) = match search.result() {
        SearchResult::NeverSaved => (None, true),
        SearchResult::SavedUntil { saved, is_monotone } => (Some(saved), is_monotone),
    };
    let provenance = failed.finished.provenance;
    let rescue = Rescue {
        rollout_id: id,
        policy: provenance.policy_name,
        policy_checkpoint_digest: provenance.policy_checkpoint_digest,
        max_steps: assignment.row.max_steps,
        saved_until: saved.map(|query| query_steps[query]),
        lost_from: match saved {
            None => query_steps.first().copied(),
            Some(query) => query_steps.get(query + 1).copied(),
        },
        looks: query_steps,
        saved_by_placebo: tried
            .iter()
            .filter(|trial| trial.placebo_success == Some(true))
            .map(|trial| trial.lifted_at)
            .collect(),
        nudge_m: NUDGE_M,
        tried,
        is_monotone,
    };
    let path = output.join("rescue.json");
    let text = serde_json::to_vec_pretty(&rescue).expect("plain data");
    fs::write(&path, text).map_err(|source| write(&path, source))?;
    Ok(rescue)
}

fn outcome_word(success: bool) -> &'static str {
    if success { "success" } else { "failure" }
}

/// Records the control steps at which the policy is queried.
#[derive(Default)]
struct QuerySteps {
    queried_at: Vec<u32>,
    /// Control steps so far.
    steps: u32,
}

impl Watcher for QuerySteps {
    fn progress(&mut self, _control_steps: u32) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn observed(&mut self, _query_index: u32, _observation: &Observation) {
        self.queried_at.push(self.steps);
    }

    fn moved(&mut self, step: Option<&Step>, _episode: &mut Episode<'_>) {
        self.steps += u32::from(step.is_some());
    }
}

/// Films the failed and the saved rollout side by side, with the policy's view of the first camera.
/// The shorter rollout stays at its last frame.
fn side_by_side(
    stage: &mut Stage<'_>,
    assignment: &Assignment,
    failed: &[Action],
    lifted_after: usize,
    saved: &Simulated,
) -> Result<Vec<u8>, FilmingError> {
    let mut pictures = |replay: Replay<'_>| {
        let mut pictures = Vec::new();
        render_again(stage, replay, &mut |[front, _]| {
            pictures.push(front.rgb);
            Ok(())
        })?;
        Ok::<_, FilmingError>(pictures)
    };
    let replay = Replay {
        row: &assignment.row,
        realisation: assignment.realisation,
        actions: failed,
        lifted_after: None,
        success: false,
    };
    let left = pictures(replay)?;
    let right = pictures(Replay {
        actions: &saved.actions,
        lifted_after: Some(lifted_after),
        success: true,
        ..replay
    })?;
    let mut encoder = VideoEncoder::new()?;
    for step in 0..left.len().max(right.len()) {
        let index = |pictures: &'_ [Vec<u8>]| pictures.len().min(step + 1) - 1;
        encoder.add([&left[index(&left)], &right[index(&right)]])?;
    }
    Ok(encoder.finish()?)
}
