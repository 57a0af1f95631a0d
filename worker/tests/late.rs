//! Rollouts with a late policy have the same bits, however long its answers take in real time.

use std::ops::ControlFlow;
use std::thread::sleep;
use std::time::Duration;

use benchmark::attempt::{EXECUTION, Motion};
use benchmark::{Execution, ManifestRow, Query, Realisation, row_of};
use proto::policy as wire;
use scene::{AssetPack, Sources};
use sim::{Episode, Renderer, Simulator, SimulatorConfig};
use worker::actor::{Action, Actor, Description, PolicyError, PolicySession};
use worker::ids::random_id;
use worker::message::{Assignment, FailureKind, Finished};
use worker::rollout::{Simulated, Step, Watcher, run};
use worker::stage::Stage;

const HORIZON: usize = 10;
const EXECUTE: usize = 6;
/// Control steps of a rollout.
const STEPS: u32 = 40;

/// Policy whose answers depend on every bit of the hand's position, so that a difference in one
/// step changes all later steps.
struct SensitivePolicy {
    /// True if each answer takes a random time.
    answers_slowly: bool,
    /// The `under_way` arguments of all queries that were given one.
    rtc_queries: Vec<Query>,
}

impl Actor for SensitivePolicy {
    fn describe(&mut self, _: PolicySession<'_>) -> Result<Description, PolicyError> {
        Ok(Description {
            about: wire::DescribeResponse::default(),
            state: vec![wire::StateField::EefPos],
            horizon: HORIZON,
            execute: EXECUTE,
        })
    }

    fn infer(
        &mut self,
        _: PolicySession<'_>,
        _query_index: u32,
        observation: wire::Observation,
        horizon: usize,
        under_way: Option<&Query>,
    ) -> Result<Vec<Action>, PolicyError> {
        if self.answers_slowly {
            let random = random_id().to_string();
            let random = u64::from_str_radix(&random[..4], 16).expect("digits");
            sleep(Duration::from_micros(random / 4));
        }
        self.rtc_queries.extend(under_way.cloned());
        let position = &observation.state[0].values;
        let action = |index: usize| {
            let mut action = [0.0; 7];
            for (axis, number) in action.iter_mut().enumerate() {
                let mixed = position[axis % 3] * 1e4 * (1.0 + axis as f64 + index as f64);
                // Answers are transmitted as 32-bit numbers.
                *number = f64::from((mixed.fract() * 0.9) as f32);
            }
            action
        };
        Ok((0..horizon).map(action).collect())
    }
}

/// Records each control step's action as it was sent.
#[derive(Default)]
struct SentActions(Vec<Action>);

impl Watcher for SentActions {
    fn progress(&mut self, _control_steps: u32) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn moved(&mut self, step: Option<&Step>, _episode: &mut Episode<'_>) {
        self.0.extend(step.map(|step| step.sent));
    }
}

/// A rollout with a result, and what its policy and its simulation recorded.
struct CompletedRollout {
    simulated: Simulated,
    sent: Vec<Action>,
    rtc_queries: Vec<Query>,
}

impl CompletedRollout {
    /// Returns the parts of the result that do not depend on time.
    fn bits(&self) -> (bool, u32, u32, u32, &Motion, &[Action]) {
        let Finished { result, motion, .. } = &self.simulated.finished;
        let counts = (result.steps, result.policy_queries, result.clipped_actions);
        let actions = &self.simulated.actions;
        (result.success, counts.0, counts.1, counts.2, motion, actions)
    }
}

fn parse_model(model: &str) -> Execution {
    model.parse().expect("a model")
}

fn simulator() -> Simulator {
    let sources = Sources::open(&Sources::default_dir());
    let sources = sources.expect("the sources; run `cargo xtask setup`");
    Simulator::new(SimulatorConfig {
        pack: AssetPack::open("primitives", &sources).expect("built in"),
        sources,
        renderer: Renderer::default(),
        cached_scenes: 1,
    })
}

fn row() -> ManifestRow {
    let id = "spatial/t0/simultaneous/L2/c00".parse().expect("an id");
    let mut row = row_of(id).expect("a row");
    row.max_steps = STEPS;
    row
}

fn run_under(simulator: &mut Simulator, model: &str, answers_slowly: bool) -> CompletedRollout {
    run_row(simulator, row().under(&parse_model(model)), answers_slowly)
}

fn run_row(simulator: &mut Simulator, row: ManifestRow, answers_slowly: bool) -> CompletedRollout {
    let mut actor = SensitivePolicy { answers_slowly, rtc_queries: Vec::new() };
    let mut assignment = Assignment::standalone(row, 0, Realisation::Matched);
    assignment.keep_actions = true;
    let mut sent = SentActions::default();
    let mut stage = Stage::of_the_protocol(simulator).with_a_renderer_only_if_needed();
    let simulated = run(&mut stage, &mut actor, &assignment, &mut sent).expect("a result");
    CompletedRollout { simulated, sent: sent.0, rtc_queries: actor.rtc_queries }
}

#[test]
fn outcomes_have_the_same_bits_however_long_the_policy_takes_by_the_clock() {
    let mut simulator = simulator();
    let waits = run_under(&mut simulator, "wait", false);
    for model in [
        "wait",
        "hold:0",
        "overlap:0",
        "overlap:0,rtc",
        "hold:3",
        "overlap:3",
        "overlap:3,rtc",
        "hold:1*1+4*2",
        "overlap:1*1+4*2",
    ] {
        let at_once = run_under(&mut simulator, model, false);
        let delayed = run_under(&mut simulator, model, true);
        assert_eq!(at_once.bits(), delayed.bits(), "{model}");
        assert_eq!(at_once.sent, delayed.sent, "{model}");
        let is_late = !model.ends_with("wait") && !model.contains(":0");
        assert_eq!(at_once.bits() == waits.bits(), !is_late, "{model}");
        let settings = &at_once.simulated.finished.provenance.policy_settings;
        let named = settings.get(EXECUTION).map_or("wait", String::as_str);
        assert_eq!(named, model);
        let ignored = settings.get("real-time chunking").map(String::as_str);
        let expected = model.ends_with("rtc").then_some("ignored by the server");
        assert_eq!(ignored, expected, "{model}");
    }
}

#[test]
fn a_latency_rollout_is_nominal_with_a_delayed_policy() {
    let mut simulator = simulator();
    let short_row = |id: &str| {
        let mut row = row_of(id.parse().expect("an id")).expect("a row");
        row.max_steps = STEPS;
        row
    };
    let late = short_row("spatial/t0/latency/L3/c00");
    let nominal = short_row(&format!("spatial/t0/nominal/i{:02}", late.init_id));
    // A row of the latency axis keeps its own model, whatever the campaign's.
    let ran = run_row(&mut simulator, late.under(&Execution::Wait), false);
    let delayed_nominal =
        run_row(&mut simulator, nominal.clone().under(&parse_model("overlap:4")), false);
    assert_eq!(ran.bits(), delayed_nominal.bits());
    assert_ne!(ran.bits(), run_row(&mut simulator, nominal, false).bits());
    let settings = &ran.simulated.finished.provenance.policy_settings;
    assert_eq!(settings[EXECUTION], "overlap:4");
}

#[test]
fn only_real_time_chunking_sends_the_actions_under_way() {
    let mut simulator = simulator();
    let ran = run_under(&mut simulator, "overlap:3,rtc", false);
    // Of ten actions, six are executed, three steps late: one query every six steps.
    let query_steps = (0..STEPS as usize).step_by(EXECUTE);
    assert_eq!(ran.rtc_queries.len(), query_steps.clone().count());
    for (query, step) in ran.rtc_queries.iter().zip(query_steps) {
        assert_eq!(query.delay, 3);
        let until = ran.sent.len().min(step + 3);
        assert_eq!(query.under_way[..until - step], ran.sent[step..until]);
    }
    assert_eq!(ran.sent[..3], [[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]; 3]);
    let without_rtc = run_under(&mut simulator, "overlap:3", false);
    assert!(without_rtc.rtc_queries.is_empty());
    assert_eq!(without_rtc.sent, ran.sent, "this policy ignores the actions under way");
}

#[test]
fn a_delay_as_long_as_an_answer_is_a_failure_on_the_latency_axis() {
    let mut simulator = simulator();
    let id = "spatial/t0/latency/r20/c00".parse().expect("an id");
    let mut late = row_of(id).expect("a row");
    late.max_steps = STEPS;
    assert_eq!(late.execution, parse_model("overlap:10"));
    let ran = run_row(&mut simulator, late, false);
    let result = &ran.simulated.finished.result;
    assert_eq!((result.success, result.steps), (false, STEPS));
    let still = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0];
    assert!(ran.sent.iter().all(|sent| *sent == still));
}

#[test]
fn a_policy_whose_every_action_would_be_dropped_is_not_run() {
    let mut simulator = simulator();
    let row = row().under(&parse_model("overlap:10"));
    let mut assignment = Assignment::standalone(row, 0, Realisation::Matched);
    assignment.policy = "nervous".to_owned();
    let mut actor = SensitivePolicy { answers_slowly: false, rtc_queries: Vec::new() };
    let mut stage = Stage::of_the_protocol(&mut simulator).with_a_renderer_only_if_needed();
    let refused = run(&mut stage, &mut actor, &assignment, &mut SentActions::default());
    let failure = refused.expect_err("too late").failure().expect("a fault");
    assert_eq!(failure.kind, FailureKind::PolicyUnavailable);
    for words in ["policy `nervous`", "`overlap:10` drops at least 10", "`hold:10`"] {
        assert!(failure.error.contains(words), "{}", failure.error);
    }
}
