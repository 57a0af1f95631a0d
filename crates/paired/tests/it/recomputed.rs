//! Comparison of all inference of reports with an independent implementation in
//! Python: tests/statistics/recompute.py.

use std::collections::BTreeMap;
use std::process::Command;

use benchmark::attempt::GoalProgress;
use benchmark::{Condition, Directions, Level, RolloutId, Suite};
use paired::{
    Bootstrap, Compared, ComparedCell, Comparison, Matched, Options, Outcome, Progress, Record,
    Records, report_of,
};
use serde_json::{Value, json};

use crate::simulated::{CONFIGURATIONS, Chance, Population};

const EXAMPLES: [&str; 2] = ["openvla_oft", "student"];
const CAMPAIGNS: u64 = 200;
const COMPARISONS: u64 = 20;

/// Published rate in the gates of all campaigns, over all suites and for each suite.
const PUBLISHED: f64 = 0.87;

fn example(name: &str) -> (Vec<Record>, Vec<Progress>) {
    let rows = crate::rows(&crate::example(name)).collect::<Vec<_>>().into_iter();
    let progress = |(record, steps): (Record, Option<u32>)| {
        (record, Progress { id: record.id, replicate: 0, steps, goal: None })
    };
    rows.map(progress).unzip()
}

/// Returns a campaign's outcomes and report in the form that the script reads.
fn campaign(name: &str, rows: &[Record]) -> Value {
    let records = Records::new(rows).expect("each rollout once");
    let options = Options {
        // The bootstrap intervals are compared in tests/reference.rs.
        bootstrap: Bootstrap { replicates: 2, ..Bootstrap::default() },
        published_nominal: Some(PUBLISHED),
        published_by_suite: Suite::ALL.map(|suite| (suite, PUBLISHED)).into(),
        ..Options::default()
    };
    let nominal = rows.iter().filter(|record| record.id.condition() == Condition::Nominal);
    let nominal: Vec<Value> = nominal
        .map(|record| {
            let (task, success) = (record.id.task(), record.outcome.success().expect("an outcome"));
            json!([task.suite() as u8, task.index(), u8::from(success)])
        })
        .collect();
    let mut levels: BTreeMap<Level, Vec<Value>> = BTreeMap::new();
    let row = |matched: &Matched| {
        let configuration = matched.configuration().expect("all outcomes");
        json!([
            matched.task.suite() as u8,
            matched.task.index(),
            matched.config,
            matched.nominal.success().map(u8::from),
            configuration.alone.values().map(|&success| u8::from(success)).collect::<Vec<_>>(),
            u8::from(configuration.simultaneous),
        ])
    };
    for matched in records.configurations() {
        levels.entry(matched.level).or_default().push(row(matched));
    }
    json!({
        "name": name,
        "levels": levels,
        "nominal": nominal,
        "published": PUBLISHED,
        "suites": Suite::ALL.map(|suite| (suite, suite as u8)),
        "report": report_of(&records, &options),
    })
}

/// Returns the pairs of outcomes and the comparison in the form that the script reads.
fn comparison(name: &str, a: Compared<'_>, b: Compared<'_>) -> Value {
    let comparison = Comparison::of(a, b, &Bootstrap::default(), |_| None);
    let records_b: BTreeMap<RolloutId, &Record> =
        b.records.iter().map(|record| (record.id, record)).collect();
    let progress = [a, b].map(|policy| {
        let by_id = policy.progress.iter().map(|progress| (progress.id, progress));
        by_id.collect::<BTreeMap<RolloutId, &Progress>>()
    });
    let cell = |cell: &ComparedCell| {
        let is_in_cell = |record: &&Record| {
            (record.id.level(), record.id.condition()) == (cell.level, cell.condition)
        };
        let pairs = a.records.iter().filter(is_in_cell).filter_map(|a| {
            let b = records_b.get(&a.id)?;
            let progress_of_pair = progress.each_ref().map(|by_id| by_id.get(&a.id));
            Some(json!([
                a.id.task().suite() as u8,
                a.id.task().index(),
                a.id.config().unwrap_or(a.init_id),
                u8::from(a.outcome.success()?),
                u8::from(b.outcome.success()?),
                progress_of_pair.map(|progress| progress
                    .and_then(|progress| progress.goal)
                    .map(|goal| [goal.at_most, goal.predicates])),
                progress_of_pair.map(|progress| progress.and_then(|progress| progress.steps)),
            ]))
        });
        json!({
            "name": cell.name(),
            "own_directions": comparison.directions == Directions::Own
                && cell.condition != Condition::Nominal,
            "pairs": pairs.collect::<Vec<_>>(),
            "difference": cell.difference,
            "progress": cell.progress,
        })
    };
    json!({"name": name, "compared": comparison.cells.iter().map(cell).collect::<Vec<_>>()})
}

/// Returns random steps and predicates of rollouts; one rollout in seven has no known predicates.
fn simulated_progress(records: &[Record], chance: &mut Chance) -> Vec<Progress> {
    let progress = records.iter().map(|record| {
        let success = record.outcome == Outcome::Success;
        let steps = if success { 80.0 + 100.0 * chance.uniform() } else { 280.0 };
        let predicates = 1 + u32::from(record.id.task().index()) % 3;
        let held = (chance.uniform() * f64::from(predicates)) as u32;
        let at_most = if success { predicates } else { held.min(predicates - 1) };
        let goal = GoalProgress { predicates, at_end: at_most, at_most };
        Progress {
            id: record.id,
            replicate: record.replicate,
            steps: Some(steps as u32),
            goal: (chance.uniform() > 1.0 / 7.0).then_some(goal),
        }
    });
    progress.collect()
}

/// Compares two policies of one population over the same tasks and directions. In 8 of the 20
/// comparisons, both campaigns declare that each task has directions of its own.
fn simulated_comparison(seed: u64) -> Value {
    let (tasks, suites) = [(2, 1), (5, 1), (10, 2), (20, 4)][seed as usize % 4];
    let population = Population::standard();
    let mut chance = Chance::new(1000 + seed);
    let effects = population.tasks(tasks, &mut chance);
    let directions = population.directions(CONFIGURATIONS, &mut chance);
    let [a, b] = [0, 1].map(|_| population.campaign(&effects, suites, &directions, &mut chance));
    let [progress_a, progress_b] = [&a, &b].map(|records| simulated_progress(records, &mut chance));
    let directions = match (seed / 4).is_multiple_of(2) {
        true => Directions::Shared,
        false => Directions::Own,
    };
    let [a, b] = [(&a, &progress_a), (&b, &progress_b)].map(|(records, progress)| Compared {
        records,
        progress,
        directions,
        has_rows: false,
    });
    comparison(&format!("simulated comparison {seed}"), a, b)
}

/// Simulates a campaign of two to twenty tasks. Every second campaign has a placebo, and every third
/// has further replicates.
fn simulated_campaign(seed: u64) -> Value {
    let (tasks, suites) = [(2, 1), (5, 1), (10, 2), (10, 1), (20, 4)][seed as usize % 5];
    let population = Population::standard();
    let mut chance = Chance::new(seed);
    let effects = population.tasks(tasks, &mut chance);
    let directions = population.directions(CONFIGURATIONS, &mut chance);
    let mut records = population.campaign(&effects, suites, &directions, &mut chance);
    if seed.is_multiple_of(2) {
        records.retain(|record| !record.id.is_placebo());
    }
    for replicate in 1..if seed.is_multiple_of(3) { 2 + seed as u32 % 2 } else { 1 } {
        let repeated = population.campaign(&effects, suites, &directions, &mut chance);
        records.extend(repeated.into_iter().map(|record| Record { replicate, ..record }));
    }
    campaign(&format!("simulated {seed}"), &records)
}

#[test]
fn reports_of_all_examples_and_two_hundred_campaigns_agree_with_numpy_and_scipy() {
    let python = std::env::var_os("ROLLOUT_PYTHON").unwrap_or_else(|| "python3".into());
    let probe = Command::new(&python).args(["-c", "import numpy, scipy"]).output();
    if !probe.is_ok_and(|output| output.status.success()) {
        println!("skipped: {} has no NumPy and SciPy", python.display());
        return;
    }
    let examples = EXAMPLES.map(|name| campaign(name, &example(name).0));
    let campaigns = examples.into_iter().chain((0..CAMPAIGNS).map(simulated_campaign));
    // Real directions, placebo and step counts; every fifth outcome differs.
    let (student, progress) = example("student");
    let mut changed = student.clone();
    for record in changed.iter_mut().step_by(5) {
        record.outcome = Outcome::from(record.outcome != Outcome::Success);
    }
    let [student, changed] = [&student, &changed]
        .map(|records| Compared { progress: &progress, ..Compared::from(records.as_slice()) });
    let students = comparison("students", student, changed);
    let comparisons = (0..COMPARISONS).map(simulated_comparison);
    let campaigns = campaigns.chain([students]).chain(comparisons);
    let campaigns: Vec<Value> = campaigns.collect();
    let folder = std::env::temp_dir().join(format!("recomputed-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join("campaigns.json");
    std::fs::write(&path, serde_json::to_vec(&campaigns).expect("JSON")).expect("written");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/statistics/recompute.py");
    let output = Command::new(&python).arg(script).arg(&path).output().expect("Python");
    std::fs::remove_dir_all(&folder).expect("removed");
    let stdout = String::from_utf8_lossy(&output.stdout);
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stdout}{error}");
    println!("{stdout}");
}
