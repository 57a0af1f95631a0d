//! A simulated slot: handles a slot's commands, sends its events and queries the real
//! policy over the real protocol, but runs no physics. Its outcomes depend only
//! on the rollout's id and the policy's actions, so that a campaign must give the same
//! results under any faults. For tests of faults and of the live page, which do not
//! need MuJoCo; its results are meaningless.

#![forbid(unsafe_code)]

use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use std::{process, thread};

use benchmark::attempt::{
    AttemptId, Digests, GoalProgress, Motion, Parts, Pin, Provenance, Realised, RolloutResult,
};
use sha2::{Digest, Sha256};
use transport::Access;
use worker::actor::{Actor, PolicyError};
use worker::message::{
    Assignment, Failure, FailureKind, Finished, RolloutEvent, SlotCommand, SlotEvent,
};
use worker::parent::Parent;
use worker::policy::{CAMPAIGN_SETTINGS, PolicyClient};

/// Number of control steps that are played. The result reports another number, from the hash of the
/// rollout's id and the policy's actions.
const STEPS: u32 = 12;
const STEP: Duration = Duration::from_millis(12);
/// Name of the simulated renderer. Its digest serves as the slot's fingerprint.
const RENDERER: &str = "simulated";
/// Number of control steps per query of the policy.
const STEPS_PER_QUERY: u32 = 4;

type Abandoned = Mutex<Option<AttemptId>>;

fn main() {
    let parent = Parent::connect().expect("a parent process");
    let abandoned = Arc::default();
    let assignments = listen(&parent, Arc::clone(&abandoned));
    send(
        &parent,
        &SlotEvent::Ready { renderer: RENDERER.to_owned(), fingerprint: digest(RENDERER) },
    );
    while let Ok(assignment) = assignments.recv() {
        let attempt = assignment.attempt;
        let send_event = |event| send(&parent, &SlotEvent::Rollout { attempt, event });
        let is_abandoned = || *abandoned.lock().expect("unpoisoned") == Some(attempt);
        send_event(rollout(&assignment, &send_event, &is_abandoned));
    }
}

/// Plays a rollout to its end, and returns its last event.
fn rollout(
    assignment: &Assignment,
    send_event: &dyn Fn(RolloutEvent),
    is_abandoned: &dyn Fn() -> bool,
) -> RolloutEvent {
    match play(assignment, send_event, is_abandoned) {
        Ok(Some(finished)) => RolloutEvent::Finished(Box::new(finished)),
        Ok(None) => RolloutEvent::Abandoned,
        Err(error) => RolloutEvent::Failed(Failure {
            kind: FailureKind::from(&error),
            error: error.to_string(),
        }),
    }
}

/// Plays a rollout to its end; `None` if it was abandoned.
fn play(
    assignment: &Assignment,
    send_event: &dyn Fn(RolloutEvent),
    is_abandoned: &dyn Fn() -> bool,
) -> Result<Option<Finished>, PolicyError> {
    let started = Instant::now();
    let row = &assignment.row;
    let session = assignment.policy_session();
    let mut policy =
        PolicyClient::new(&assignment.policy_endpoint, &Access::none(), CAMPAIGN_SETTINGS)?;
    let description = policy.describe(session)?;
    policy.reset(session, &row.instruction, assignment.policy_seed)?;
    let mut parts = Parts::default();
    let mut hash = Sha256::new();
    hash.update(row.id.published());
    for step in 0..STEPS {
        if is_abandoned() {
            return Ok(None);
        }
        if step % STEPS_PER_QUERY == 0 {
            let query = step / STEPS_PER_QUERY;
            let observation = proto::policy::Observation::default();
            let sent = Instant::now();
            let actions = policy.infer(session, query, observation, description.horizon, None)?;
            parts.policy_secs += sent.elapsed().as_secs_f64();
            for number in actions.iter().flatten() {
                hash.update(number.to_le_bytes());
            }
        }
        thread::sleep(STEP);
        // The sleep counts as physics.
        parts.physics_secs += STEP.as_secs_f64();
        send_event(RolloutEvent::Progress(row.settle_steps + step + 1));
    }
    policy.end(session);
    let hash = hash.finalize();
    let about = description.about;
    let success = hash[0].is_multiple_of(2);
    Ok(Some(Finished {
        result: RolloutResult {
            success,
            steps: (20 + u32::from(hash[1])).min(row.max_steps),
            wall_secs: started.elapsed().as_secs_f64(),
            policy_queries: STEPS / STEPS_PER_QUERY,
            parts,
            goal: GoalProgress { predicates: 1, at_end: success.into(), at_most: success.into() },
            digests: Digests {
                scene: digest(&row.id.task().to_string()),
                init_state: digest(&format!("{} {}", row.id.task(), row.init_id)),
                first_frame: String::new(),
            },
            realised: realised(assignment),
            ..RolloutResult::default()
        },
        provenance: Provenance {
            pin: Pin { renderer: RENDERER.to_owned(), ..Pin::default() },
            fingerprint: digest(RENDERER),
            realisation: assignment.realisation.to_string(),
            policy_name: about.name,
            policy_checkpoint: about.checkpoint,
            policy_checkpoint_digest: about.checkpoint_digest,
            policy_privileged: about.privileged,
            policy_canonical_only: about.language
                == i32::from(proto::policy::Language::CanonicalOnly),
            policy_settings: [("execute".to_owned(), about.execute.to_string())].into(),
            batch_mode: "single".to_owned(),
            ..Provenance::default()
        },
        motion: Motion::pack(&path(&hash), &[]),
        is_filmed_next: false,
    }))
}

/// Returns a synthetic path: an arc whose size follows from the rollout's hash, 0.9 m above the
/// origin; in units of 0.1 mm.
fn path(hash: &[u8]) -> Vec<[i16; 3]> {
    let (width, height) = (i16::from(hash[2]) * 8, i16::from(hash[3]) * 4);
    let point = |step: u32| {
        let angle = f64::from(step) * std::f64::consts::PI / f64::from(STEPS);
        [
            (f64::from(width) * angle.cos()) as i16,
            0,
            (f64::from(height) * angle.sin()) as i16 + 9_000,
        ]
    };
    (0..=STEPS).map(point).collect()
}

fn realised(assignment: &Assignment) -> Realised {
    let perturbation = &assignment.row.perturbation;
    let mut realised = Realised::default();
    for axis in perturbation.axes() {
        realised.add(axis, perturbation.values(axis), Vec::new());
    }
    realised
}

fn digest(text: &str) -> String {
    hex::encode(Sha256::digest(text))
}

fn send(parent: &Parent, event: &SlotEvent) {
    if parent.send(event).is_err() {
        // The parent has exited, so that no event can be delivered.
        process::exit(0);
    }
}

/// Reads commands on a separate thread; exits the program at their end.
fn listen(parent: &Parent, abandoned: Arc<Abandoned>) -> Receiver<Assignment> {
    let commands = parent.listen().expect("a parent process");
    let (sender, assignments) = sync_channel(1);
    thread::spawn(move || {
        for command in commands {
            match command.expect("a command") {
                SlotCommand::Abandon(attempt) => {
                    *abandoned.lock().expect("unpoisoned") = Some(attempt);
                }
                SlotCommand::Run(assignment) => {
                    if sender.send(*assignment).is_err() {
                        break;
                    }
                }
            }
        }
        process::exit(0);
    });
    assignments
}
