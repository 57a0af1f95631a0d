//! Tests of lifted perturbations, on the built-in assets.

use benchmark::{ManifestRow, Realisation, row_of};
use sim::ObjectKind;
use sim::controller::GRIP_SITE;

use super::*;
use crate::single::tests::{ObservingActor, assignment, simulator};

const SIDE: u32 = 64;
const STEPS: u32 = 12;

/// Observations of a policy, and the path of the hand.
struct Observed {
    pictures: Vec<[Vec<u8>; 2]>,
    instruction_is_canonical: bool,
    path: Vec<[i16; 3]>,
    actions: Vec<Action>,
}

fn row(id: &str) -> ManifestRow {
    let mut row = row_of(id.parse().expect("an id")).expect("a row");
    row.max_steps = STEPS;
    row
}

fn run_rollout(
    simulator: &mut Simulator,
    row: ManifestRow,
    resumed: Option<Resumed<'_>>,
) -> Observed {
    let mut actor =
        ObservingActor { side: SIDE, observations: Vec::new(), instructions: Vec::new() };
    let canonical = row.id.task().instruction();
    let assignment = assignment(row, None);
    let mut stage = Stage::of_the_protocol(simulator);
    let mut watcher = QuerySteps::default();
    let simulated =
        rollout::run_resumed(resumed, &mut stage, &mut actor, &assignment, &mut watcher)
            .expect("an outcome");
    let both = |query: usize| [0, 1].map(|at| camera_of(&actor.observations[query], at));
    Observed {
        pictures: (0..actor.observations.len()).map(both).collect(),
        instruction_is_canonical: actor.instructions == [canonical],
        path: simulated.finished.motion.path(),
        actions: simulated.actions,
    }
}

fn resumed_after(commands: &[Action], change: Change) -> Option<Resumed<'_>> {
    Some(Resumed { commands, change })
}

fn camera_of(observation: &proto::policy::Observation, at: usize) -> Vec<u8> {
    observation.images[at].rgb.to_vec()
}

#[test]
fn lifting_before_the_first_query_gives_the_nominal_rollout() {
    let mut simulator = simulator();
    // All axes but the robot's are perturbed, because its displacement of the arm would remain.
    let perturbed = row("object/t0/camera+lighting+sensor+actuation+language/L2/c00");
    let nominal = row(&format!("object/t0/nominal/i{:02}", perturbed.init_id));
    let nominal = run_rollout(&mut simulator, nominal, None);
    let lifted = run_rollout(&mut simulator, perturbed.clone(), resumed_after(&[], Change::Lift));
    assert!(lifted.pictures == nominal.pictures, "the pictures differ");
    assert_eq!(lifted.path, nominal.path);
    assert!(lifted.instruction_is_canonical && nominal.instruction_is_canonical);

    let perturbed = run_rollout(&mut simulator, perturbed, None);
    assert!(!perturbed.instruction_is_canonical);
    for (perturbed, nominal) in perturbed.pictures[0].iter().zip(&nominal.pictures[0]) {
        assert!(perturbed != nominal, "the perturbation is invisible");
    }
}

#[test]
fn a_resumed_rollout_repeats_the_earlier_steps() {
    let mut simulator = simulator();
    let perturbed = row("object/t0/simultaneous/L2/c00");
    let uninterrupted = run_rollout(&mut simulator, perturbed.clone(), None);
    let step = 5;
    let commands = &uninterrupted.actions[..step];
    let resumed =
        run_rollout(&mut simulator, perturbed.clone(), resumed_after(commands, Change::Lift));
    assert_eq!(resumed.path[..=step], uninterrupted.path[..=step]);
    assert_eq!(resumed.path.len(), uninterrupted.path.len());
    assert_eq!(resumed.pictures.len(), STEPS as usize - step);
    // The camera is nominal again, and actions are no longer distorted.
    assert!(resumed.pictures[0] != uninterrupted.pictures[step]);
    assert_ne!(resumed.path[STEPS as usize], uninterrupted.path[STEPS as usize]);

    // The nudge moves no object, and the hand stays within 0.1 mm of the uninterrupted path.
    let nudged = run_rollout(&mut simulator, perturbed, resumed_after(commands, Change::Nudge));
    assert!(!nudged.instruction_is_canonical);
    assert!(nudged.pictures[0] == uninterrupted.pictures[step]);
    let pairs = nudged.path.iter().zip(&uninterrupted.path);
    for (nudged, uninterrupted) in pairs {
        for (nudged, uninterrupted) in nudged.iter().zip(uninterrupted) {
            assert!((nudged - uninterrupted).abs() <= 1, "{nudged} {uninterrupted}");
        }
    }
}

#[test]
fn a_nudge_moves_the_hand_up_by_a_micrometre_and_no_object() {
    let mut simulator = simulator();
    let mut stage = Stage::of_the_protocol(&mut simulator);
    let row = row("object/t0/simultaneous/L2/c00");
    let mut episode = stage.begin(&row, Realisation::Matched).expect("an episode");
    episode.settle().expect("settled");
    let pose = |episode: &mut Episode<'_>| {
        let (model, data) = episode.environment().model_and_data();
        data.forward(model);
        let site = model.id(ObjectKind::Site, GRIP_SITE).expect("the hand");
        let hand: [f64; 3] = std::array::from_fn(|axis| data.site_xpos(model)[3 * site + axis]);
        (data.qpos(model).to_vec(), hand)
    };
    let (before, from) = pose(&mut episode);
    episode.nudge();
    let (after, to) = pose(&mut episode);
    let moved = [0, 1, 2].map(|axis| to[axis] - from[axis]);
    assert!(moved[0].abs() < 1e-9 && moved[1].abs() < 1e-9, "{moved:?}");
    assert!((moved[2] - NUDGE_M).abs() < 1e-9, "{moved:?}");
    assert_ne!(before[..7], after[..7]);
    assert_eq!(before[7..], after[7..]);
}

#[test]
fn a_rollout_without_perturbations_is_refused() {
    let mut simulator = simulator();
    let folder = tempfile::tempdir().expect("a temporary folder");
    for id in ["object/t0/nominal/i00", "object/t0/latency/L2/c00"] {
        let mut actor =
            ObservingActor { side: SIDE, observations: Vec::new(), instructions: Vec::new() };
        let assignment = assignment(row(id), None);
        let (assignment, output) = (&assignment, folder.path());
        let request = Request { assignment, capsule: None, films: true, output };
        let refused = run(&mut simulator, &mut actor, &request);
        assert!(matches!(refused, Err(RescueError::NotPerturbed(_))), "{id}");
        assert!(actor.observations.is_empty(), "{id}");
    }
}
