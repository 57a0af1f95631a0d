//! Tests of the statistics: cases worked out by hand, properties, published results, independent
//! implementations, and simulated policies.

mod comparison;
mod non_inferiority;
mod planted_effects;
mod progress;
mod published;
mod recomputed;
mod reference;
mod report;
mod sequential;
// The example `coverage` uses functions that no test does.
#[allow(dead_code)]
mod simulated;
mod stops;

use std::path::Path;

use benchmark::TaskRef;
use paired::{Outcome, Record};
use serde_json::Value;

const S: Outcome = Outcome::Success;
const F: Outcome = Outcome::Failure;
const M: Outcome = Outcome::Missing;
const Q: Outcome = Outcome::Quarantined;

fn task(index: usize) -> TaskRef {
    TaskRef::all().nth(index).expect("one of forty")
}

fn rows(text: &str) -> impl Iterator<Item = (Record, Option<u32>)> {
    text.lines().map(|line| {
        let row: Value = serde_json::from_str(line).expect("a row");
        let record = Record {
            id: row["rollout_id"].as_str().expect("a text").parse().expect("an id"),
            init_id: row["init_id"].as_u64().expect("a number") as u16,
            replicate: 0,
            outcome: Outcome::from(row["success"].as_bool().expect("an outcome")),
        };
        (record, row["steps"].as_u64().map(|steps| steps as u32))
    })
}

fn records(text: &str) -> Vec<Record> {
    rows(text).map(|(record, _)| record).collect()
}

fn example(name: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    std::fs::read_to_string(root.join(name).join("rollouts.jsonl")).expect("the example")
}
