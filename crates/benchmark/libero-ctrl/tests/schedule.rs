//! Compares the executed action of each control step with a plain model of the whole timeline.

use std::ops::Range;

use libero_ctrl::{Action, Command, Execution, Schedule, TaskRef};
use proptest::prelude::*;

const STEPS: usize = 120;
const INIT: u16 = 7;

fn task() -> TaskRef {
    TaskRef::all().next().expect("a task")
}

/// Returns an action that identifies its query and its index in the response; the gripper varies.
fn action(query: u32, place: usize) -> Action {
    let gripper = if (query as usize + place).is_multiple_of(3) {
        1.0
    } else {
        -1.0
    };
    [f64::from(query), place as f64, 0.5, 0.0, 0.0, 0.0, gripper]
}

/// Returns the number of actions in a response, which may be below the policy's declared number.
fn length(lengths: &[usize], query: u32) -> usize {
    lengths[query as usize % lengths.len()]
}

struct Ran {
    /// Step, delay and scheduled commands (`under_way`) of each query.
    queries: Vec<(usize, u32, Vec<Action>)>,
    commands: Vec<Command>,
}

fn run(execution: &str, execute: usize, lengths: &[usize]) -> Ran {
    let execution: Execution = execution.parse().expect("an execution model");
    let mut schedule = Schedule::new(execution, execute, task(), INIT);
    let mut ran = Ran {
        queries: Vec::new(),
        commands: Vec::new(),
    };
    for step in 0..STEPS {
        if let Some(due) = schedule.due() {
            let query = ran.queries.len() as u32;
            ran.queries.push((step, due.delay, due.under_way));
            let count = length(lengths, query);
            schedule.answer((0..count).map(|place| action(query, place)).collect());
            assert_eq!(schedule.due(), None, "one query at a time");
        }
        ran.commands.push(schedule.advance());
    }
    ran
}

/// Returns the timeline under `wait`: up to `execute` actions of each response, one after the
/// other.
fn waiting(execute: usize, lengths: &[usize]) -> Vec<Option<(u32, usize)>> {
    let mut timeline = Vec::new();
    for query in 0.. {
        for place in 0..length(lengths, query).min(execute) {
            timeline.push(Some((query, place)));
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
    let mut line = vec![None; STEPS + 500];
    let mut asked = Vec::new();
    let mut step = 0;
    while step < STEPS {
        let query = asked.len() as u32;
        let (delay, length) = (delays(query), length(lengths, query));
        asked.push(step);
        let taken: Range<usize> = match overlaps {
            true => delay.min(length)..length,
            false => 0..length.min(execute),
        };
        line[step + delay..].fill(None);
        let count = taken.len();
        for (later, place) in taken.enumerate() {
            line[step + delay + later] = Some((query, place));
        }
        step += match overlaps {
            true => delay.max(count.min(execute)).max(1),
            false => delay + count,
        };
    }
    line.truncate(STEPS);
    (asked, line)
}

/// Returns the commands of a timeline: where no action is executed, the arm rests and the gripper
/// keeps its last command.
fn commands(line: &[Option<(u32, usize)>]) -> Vec<Action> {
    let mut gripper = -1.0;
    let command = line.iter().map(|source| {
        let command = match *source {
            Some((query, place)) => action(query, place),
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
    let of_query = |query| {
        let delays = execution.delays();
        usize::from(delays.map_or(0, |it| it.of_query(task(), INIT, query)))
    };
    let (asked, line) = timeline(overlaps, &of_query, execute, lengths);
    let ran = run(text, execute, lengths);
    let sources: Vec<_> = ran.commands.iter().map(|command| command.source).collect();
    prop_assert_eq!(&sources, &line);
    let given: Vec<Action> = ran.commands.iter().map(|command| command.action).collect();
    prop_assert_eq!(&given, &commands(&line));
    let steps: Vec<usize> = ran.queries.iter().map(|(step, ..)| *step).collect();
    prop_assert_eq!(steps, asked);
    for (query, (step, delay, under_way)) in ran.queries.iter().enumerate() {
        prop_assert_eq!(*delay as usize, of_query(query as u32));
        // The commands sent with the query are those executed until its response takes effect.
        let until = STEPS.min(step + *delay as usize);
        prop_assert_eq!(&under_way[..until - step], &given[*step..until]);
    }
    Ok(())
}

proptest! {
    #[test]
    fn every_step_executes_what_a_plain_model_says(
        model in prop::sample::select(vec!["hold", "overlap"]),
        delay in 0_u16..40,
        execute in 1_usize..20,
        lengths in prop::collection::vec(1_usize..20, 1..5),
    ) {
        check(&format!("{model}:{delay}"), execute, &lengths)?;
    }

    #[test]
    fn so_it_does_with_drawn_delays(
        model in prop::sample::select(vec!["hold", "overlap"]),
        delays in prop::collection::btree_map(0_u16..30, 1_u32..9, 1..6),
        execute in 1_usize..20,
        lengths in prop::collection::vec(1_usize..20, 1..5),
    ) {
        let terms: Vec<String> = delays.iter().map(|(steps, weight)| format!("{steps}*{weight}")).collect();
        check(&format!("{model}:{}", terms.join("+")), execute, &lengths)?;
    }

    #[test]
    fn no_delay_is_waiting_step_for_step(
        execute in 1_usize..20,
        lengths in prop::collection::vec(1_usize..20, 1..5),
    ) {
        let expected = waiting(execute, &lengths);
        for model in ["wait", "hold:0", "overlap:0", "overlap:0,rtc"] {
            let ran = run(model, execute, &lengths);
            let sources: Vec<_> = ran.commands.iter().map(|command| command.source).collect();
            prop_assert_eq!(&sources, &expected, "{}", model);
        }
    }
}

/// A readable example: answers of 8 actions, of which 6 are executed, 3 steps late.
#[test]
fn an_answer_takes_over_three_steps_after_it_was_asked_for() {
    let ran = run("overlap:3", 6, &[8]);
    let asked: Vec<usize> = ran.queries.iter().map(|(step, ..)| *step).collect();
    assert_eq!(asked[..4], [0, 5, 10, 15], "as early as no gap needs");
    let places: Vec<_> = ran.commands.iter().map(|it| it.source).collect();
    let of = |query, place| Some((query, place));
    assert_eq!(
        places[..13],
        [
            None,
            None,
            None,
            of(0, 3),
            of(0, 4),
            of(0, 5),
            of(0, 6),
            of(0, 7),
            of(1, 3),
            of(1, 4),
            of(1, 5),
            of(1, 6),
            of(1, 7),
        ]
    );
}
