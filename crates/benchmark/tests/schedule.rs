//! Compares the command of each control step with a timeline that a simple model computes as a
//! whole.

use std::ops::Range;

use benchmark::{Action, Command, Execution, Schedule, TaskRef};
use proptest::prelude::*;

const STEPS: usize = 120;
const INIT_ID: u16 = 7;

fn task() -> TaskRef {
    TaskRef::all().next().expect("a task")
}

/// Returns an action that identifies its query and its index in the response; the gripper varies.
fn action(query: u32, index: usize) -> Action {
    let gripper = if (query as usize + index).is_multiple_of(3) { 1.0 } else { -1.0 };
    [f64::from(query), index as f64, 0.5, 0.0, 0.0, 0.0, gripper]
}

/// Returns the number of actions in a response, which may be below the policy's declared number.
fn length(lengths: &[usize], query: u32) -> usize {
    lengths[query as usize % lengths.len()]
}

struct Run {
    /// Step, delay and scheduled commands (`under_way`) of each query.
    queries: Vec<(usize, u32, Vec<Action>)>,
    commands: Vec<Command>,
}

fn run(execution: &str, execute: usize, lengths: &[usize]) -> Run {
    let execution: Execution = execution.parse().expect("an execution model");
    let mut schedule = Schedule::new(execution, execute, task(), INIT_ID);
    let mut run_result = Run { queries: Vec::new(), commands: Vec::new() };
    for step in 0..STEPS {
        if let Some(due) = schedule.due() {
            let query = run_result.queries.len() as u32;
            run_result.queries.push((step, due.delay, due.under_way));
            let count = length(lengths, query);
            schedule.answer((0..count).map(|index| action(query, index)).collect());
            assert_eq!(schedule.due(), None, "one query at a time");
        }
        run_result.commands.push(schedule.advance());
    }
    run_result
}

/// Up to `execute` actions of each response follow one another.
fn timeline_of_wait(execute: usize, lengths: &[usize]) -> Vec<Option<(u32, usize)>> {
    let mut timeline = Vec::new();
    for query in 0.. {
        for index in 0..length(lengths, query).min(execute) {
            timeline.push(Some((query, index)));
            if timeline.len() == STEPS {
                return timeline;
            }
        }
    }
    timeline
}

/// Returns the timeline under a model with delays: the arm holds still until a response replaces
/// the remaining timeline from the step at which it takes effect.
fn timeline(
    overlaps: bool,
    delays: &dyn Fn(u32) -> usize,
    execute: usize,
    lengths: &[usize],
) -> (Vec<usize>, Vec<Option<(u32, usize)>>) {
    let mut timeline = vec![None; STEPS + 500];
    let mut query_steps = Vec::new();
    let mut step = 0;
    while step < STEPS {
        let query = query_steps.len() as u32;
        let (delay, length) = (delays(query), length(lengths, query));
        query_steps.push(step);
        let used: Range<usize> = match overlaps {
            true => delay.min(length)..length,
            false => 0..length.min(execute),
        };
        timeline[step + delay..].fill(None);
        let count = used.len();
        for (offset, index) in used.enumerate() {
            timeline[step + delay + offset] = Some((query, index));
        }
        step += if overlaps { delay.max(count.min(execute)).max(1) } else { delay + count };
    }
    timeline.truncate(STEPS);
    (query_steps, timeline)
}

/// Returns the commands of a timeline: in a step without an action, the arm holds still and the
/// gripper keeps its last command.
fn commands(timeline: &[Option<(u32, usize)>]) -> Vec<Action> {
    let mut gripper = -1.0;
    let command = timeline.iter().map(|source| {
        let command = match *source {
            Some((query, index)) => action(query, index),
            None => [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, gripper],
        };
        gripper = command[6];
        command
    });
    command.collect()
}

fn check(text: &str, execute: usize, lengths: &[usize]) -> Result<(), TestCaseError> {
    let execution: Execution = text.parse().expect("an execution model");
    let overlaps = matches!(execution, Execution::Overlap { .. });
    let delay_of = |query| {
        let delays = execution.delays();
        usize::from(delays.map_or(0, |delays| delays.of_query(task(), INIT_ID, query)))
    };
    let (query_steps, expected) = timeline(overlaps, &delay_of, execute, lengths);
    let run_result = run(text, execute, lengths);
    let sources: Vec<_> = run_result.commands.iter().map(|command| command.source).collect();
    prop_assert_eq!(&sources, &expected);
    let executed: Vec<Action> = run_result.commands.iter().map(|command| command.action).collect();
    prop_assert_eq!(&executed, &commands(&expected));
    let steps: Vec<usize> = run_result.queries.iter().map(|(step, ..)| *step).collect();
    prop_assert_eq!(steps, query_steps);
    for (query, (step, delay, under_way)) in run_result.queries.iter().enumerate() {
        prop_assert_eq!(*delay as usize, delay_of(query as u32));
        // The first commands sent with the query are executed until its response takes effect.
        let until = STEPS.min(step + *delay as usize);
        prop_assert_eq!(&under_way[..until - step], &executed[*step..until]);
    }
    Ok(())
}

proptest! {
    #[test]
    fn the_commands_equal_the_timeline_with_a_constant_delay(
        model in prop::sample::select(vec!["hold", "overlap"]),
        delay in 0_u16..40,
        execute in 1_usize..20,
        lengths in prop::collection::vec(1_usize..20, 1..5),
    ) {
        check(&format!("{model}:{delay}"), execute, &lengths)?;
    }

    #[test]
    fn the_commands_equal_the_timeline_with_drawn_delays(
        model in prop::sample::select(vec!["hold", "overlap"]),
        delays in prop::collection::btree_map(0_u16..30, 1_u32..9, 1..6),
        execute in 1_usize..20,
        lengths in prop::collection::vec(1_usize..20, 1..5),
    ) {
        let terms = delays.iter().map(|(steps, weight)| format!("{steps}*{weight}"));
        let terms: Vec<String> = terms.collect();
        check(&format!("{model}:{}", terms.join("+")), execute, &lengths)?;
    }

    #[test]
    fn a_delay_of_zero_is_equivalent_to_wait(
        execute in 1_usize..20,
        lengths in prop::collection::vec(1_usize..20, 1..5),
    ) {
        let expected = timeline_of_wait(execute, &lengths);
        for model in ["wait", "hold:0", "overlap:0", "overlap:0,rtc"] {
            let run_result = run(model, execute, &lengths);
            let sources = run_result.commands.iter().map(|command| command.source);
            let sources: Vec<_> = sources.collect();
            prop_assert_eq!(&sources, &expected, "{}", model);
        }
    }
}

/// A readable example: responses of 8 actions, of which up to 6 are executed, 3 steps late.
#[test]
fn a_response_takes_effect_three_steps_after_its_query() {
    let run_result = run("overlap:3", 6, &[8]);
    let query_steps: Vec<usize> = run_result.queries.iter().map(|(step, ..)| *step).collect();
    assert_eq!(
        query_steps[..4],
        [0, 5, 10, 15],
        "as late as possible without a gap between responses"
    );
    let sources: Vec<_> = run_result.commands.iter().map(|command| command.source).collect();
    let source = |query, index| Some((query, index));
    assert_eq!(
        sources[..13],
        [
            None,
            None,
            None,
            source(0, 3),
            source(0, 4),
            source(0, 5),
            source(0, 6),
            source(0, 7),
            source(1, 3),
            source(1, 4),
            source(1, 5),
            source(1, 6),
            source(1, 7),
        ]
    );
}
