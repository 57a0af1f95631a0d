//! Comparison of all inference of reports with an independent implementation in
//! Python: tests/statistics/recompute.py.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use libero_ctrl::{Level, RolloutId};
use paired::{
    Bootstrap, ComparedCell, Comparison, Matched, Options, Outcome, Record, Records, report_of,
};
use serde_json::{Value, json};

// The coverage command uses the rest.
#[allow(dead_code)]
mod simulated;

use simulated::{CONFIGURATIONS, Chance, Population};

const EXAMPLES: [&str; 3] = ["openvla_oft", "student", "student_randomised"];
const CAMPAIGNS: u64 = 200;
const COMPARISONS: u64 = 20;

fn example(name: &str) -> Vec<Record> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../examples");
    let path = root.join(name).join("rollouts.jsonl");
    let text = std::fs::read_to_string(&path).expect("the example");
    let record = |line: &str| {
        let row: Value = serde_json::from_str(line).expect("JSON");
        let id: RolloutId = row["rollout_id"]
            .as_str()
            .expect("a text")
            .parse()
            .expect("an id");
        Record {
            id,
            init_id: row["init_id"].as_u64().expect("a number") as u16,
            replicate: 0,
            outcome: Outcome::from(row["success"].as_bool().expect("an outcome")),
        }
    };
    text.lines().map(record).collect()
}

/// Outcomes and report in the form that the script reads.
fn campaign(name: &str, records: &[Record]) -> Value {
    let records = Records::new(records).expect("each rollout once");
    let options = Options {
        // The paper's intervals are compared in tests/reference.rs.
        bootstrap: Bootstrap {
            replicates: 2,
            ..Bootstrap::default()
        },
        ..Options::default()
    };
    let mut levels: BTreeMap<Level, Vec<Value>> = BTreeMap::new();
    let row = |matched: &Matched| {
        let configuration = matched.configuration().expect("all outcomes");
        json!([
            matched.task.suite() as u8,
            matched.task.index(),
            matched.config,
            matched.nominal.success().map(u8::from),
            configuration
                .alone
                .values()
                .map(|&it| u8::from(it))
                .collect::<Vec<_>>(),
            u8::from(configuration.simultaneous),
        ])
    };
    for matched in records.configurations() {
        levels.entry(matched.level).or_default().push(row(matched));
    }
    json!({"name": name, "levels": levels, "report": report_of(&records, &options)})
}

/// Pairs of outcomes and the comparison in the form that the script reads.
fn comparison(name: &str, a: &[Record], b: &[Record]) -> Value {
    let found = Comparison::of(a, b, &Bootstrap::default(), |_| None);
    let of_b: BTreeMap<RolloutId, &Record> = b.iter().map(|it| (it.id, it)).collect();
    let cell = |cell: &ComparedCell| {
        let of_cell =
            |it: &&Record| (it.id.level(), it.id.condition()) == (cell.level, cell.condition);
        let pairs = a.iter().filter(of_cell).filter_map(|a| {
            let b = of_b.get(&a.id)?;
            Some(json!([
                a.id.task().suite() as u8,
                a.id.task().index(),
                a.id.config().unwrap_or(a.init_id),
                u8::from(a.outcome.success()?),
                u8::from(b.outcome.success()?),
            ]))
        });
        json!({
            "name": cell.name(),
            "pairs": pairs.collect::<Vec<_>>(),
            "difference": cell.difference,
        })
    };
    json!({"name": name, "compared": found.cells.iter().map(cell).collect::<Vec<_>>()})
}

/// Two policies of one population over the same tasks and directions.
fn simulated_comparison(seed: u64) -> Value {
    let (tasks, suites) = [(2, 1), (5, 1), (10, 2), (20, 4)][seed as usize % 4];
    let population = Population::usual();
    let mut chance = Chance::new(1000 + seed);
    let effects = population.tasks(tasks, &mut chance);
    let directions = population.directions(CONFIGURATIONS, &mut chance);
    let [a, b] = [0, 1].map(|_| population.campaign(&effects, suites, &directions, &mut chance));
    comparison(&format!("simulated comparison {seed}"), &a, &b)
}

/// Two, five, ten, … tasks, with a placebo in every second campaign.
fn simulated_campaign(seed: u64) -> Value {
    let (tasks, suites) = [(2, 1), (5, 1), (10, 2), (10, 1), (20, 4)][seed as usize % 5];
    let population = Population::usual();
    let mut chance = Chance::new(seed);
    let effects = population.tasks(tasks, &mut chance);
    let directions = population.directions(CONFIGURATIONS, &mut chance);
    let mut records = population.campaign(&effects, suites, &directions, &mut chance);
    if seed.is_multiple_of(2) {
        records.retain(|record| !record.id.is_placebo());
    }
    campaign(&format!("simulated {seed}"), &records)
}

#[test]
fn three_examples_and_two_hundred_campaigns_are_recomputed_by_numpy_and_scipy() {
    let python = std::env::var_os("ROLLOUT_PYTHON").unwrap_or_else(|| "python3".into());
    let asked = Command::new(&python)
        .args(["-c", "import numpy, scipy"])
        .output();
    if !asked.is_ok_and(|output| output.status.success()) {
        println!("skipped: {} has no NumPy and SciPy", python.display());
        return;
    }
    let examples = EXAMPLES.map(|name| campaign(name, &example(name)));
    let campaigns = examples
        .into_iter()
        .chain((0..CAMPAIGNS).map(simulated_campaign));
    let [_, student, randomised] = EXAMPLES.map(example);
    let students = comparison("students", &student, &randomised);
    let comparisons = (0..COMPARISONS).map(simulated_comparison);
    let campaigns = campaigns.chain([students]).chain(comparisons);
    let campaigns: Vec<Value> = campaigns.collect();
    let folder = std::env::temp_dir().join(format!("recomputed-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join("campaigns.json");
    std::fs::write(&path, serde_json::to_vec(&campaigns).expect("JSON")).expect("written");
    let script = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../../tests/statistics/recompute.py"
    );
    let output = Command::new(&python)
        .arg(script)
        .arg(&path)
        .output()
        .expect("Python");
    std::fs::remove_dir_all(&folder).expect("removed");
    let said = String::from_utf8_lossy(&output.stdout);
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}{error}");
    println!("{said}");
}
