//! Tests of the built-in pack on all 40 tasks: each of the 50 released states loads and comes to
//! rest in place, no goal holds by itself, and every goal can be reached.

mod hand;
mod table;

use benchmark::{ManifestRow, Perturbation, Realisation, RolloutId, Suite, TaskRef};
use scene::{Problem, TaskFiles};
use sim::episode::NO_OP;
use sim::{Episode, Renderer, Simulator, SimulatorConfig};
use tests::files::{primitives, sources};

use hand::reach_goal;
use table::{MAX_DRIFT, MAX_OVERLAP, Released, deepest_overlap};

const STATES: u16 = 50;
/// A released state in which cream cheese and milk overlap, so that even the original LIBERO throws
/// an object, by 152 mm; and the distance that is allowed here, m.
const THROWN: (&str, u16, f64) = ("libero_10/0", 45, 0.16);
/// Control steps in which a released scene comes to rest.
const SETTLE_STEPS: usize = 10;

fn check_suite(suite: Suite) {
    let sources = sources();
    let mut simulator = Simulator::new(SimulatorConfig {
        pack: primitives(&sources),
        sources: sources.clone(),
        renderer: Renderer::default(),
        cached_scenes: 1,
    });
    let mut problems = Vec::new();
    for task in suite.tasks() {
        let files = TaskFiles::of_task(&sources, task);
        let problem = files.problem().unwrap();
        for state in 0..STATES {
            let mut episode = begin(&mut simulator, task, state);
            let drift = match THROWN {
                (thrown, id, drift) if task.to_string() == thrown && state == id => drift,
                _ => MAX_DRIFT,
            };
            for found in settle(&mut episode, &problem, drift) {
                problems.push(format!("{task}, state {state}: {found}"));
            }
            if state == 0
                && let Err(found) = reach_goal(&mut episode)
            {
                problems.push(format!("{task}: {found}"));
            }
        }
    }
    assert!(problems.is_empty(), "\n{}", problems.join("\n"));
}

/// Begins a nominal rollout of a task from one of its released states.
fn begin(simulator: &mut Simulator, task: TaskRef, state: u16) -> Episode<'_> {
    let (suite, index) = (task.suite().short_name(), task.index());
    let id: RolloutId = format!("{suite}/t{index}/nominal/i{state:02}").parse().unwrap();
    let row = ManifestRow::new(id, state, state, Perturbation::default());
    simulator.begin(&row, Realisation::Matched).unwrap_or_else(|error| panic!("{task}: {error}"))
}

/// Lets a released scene come to rest; returns descriptions of the faults at rest.
fn settle(episode: &mut Episode<'_>, problem: &Problem, drift: f64) -> Vec<String> {
    let released = Released::record(problem, episode);
    for _ in 0..SETTLE_STEPS {
        if let Err(error) = episode.environment().step(&NO_OP) {
            return vec![error.to_string()];
        }
    }
    let mut problems = released.compare(episode, drift);
    let (depth, pair) = deepest_overlap(episode.environment());
    if depth > MAX_OVERLAP {
        problems.push(format!("{pair} overlap by {:.1} mm", depth * 1e3));
    }
    if episode.environment().succeeded() {
        problems.push("the goal holds by itself".to_owned());
    }
    problems
}

#[test]
fn the_built_in_pack_settles_and_can_be_solved_on_libero_spatial() {
    check_suite(Suite::Spatial);
}

#[test]
fn the_built_in_pack_settles_and_can_be_solved_on_libero_object() {
    check_suite(Suite::Object);
}

#[test]
fn the_built_in_pack_settles_and_can_be_solved_on_libero_goal() {
    check_suite(Suite::Goal);
}

#[test]
fn the_built_in_pack_settles_and_can_be_solved_on_libero_10() {
    check_suite(Suite::Long);
}
