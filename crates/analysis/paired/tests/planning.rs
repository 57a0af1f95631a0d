//! The built-in assumed outcomes agree with the student's published ones.

use paired::{Assumed, Outcome, Record};
use serde_json::Value;

const STUDENT: &str = include_str!("../../../../examples/student/rollouts.jsonl");

#[test]
fn built_in_assumptions_agree_with_the_students_published_outcomes() {
    let record = |line: &str| {
        let row: Value = serde_json::from_str(line).expect("JSON");
        Record {
            id: row["rollout_id"].as_str().and_then(|id| id.parse().ok()).expect("an id"),
            init_id: row["init_id"].as_u64().expect("a state") as u16,
            replicate: 0,
            outcome: Outcome::from(row["success"].as_bool().expect("an outcome")),
        }
    };
    let records: Vec<Record> = STUDENT.lines().map(record).collect();
    let summary = Assumed::of(&records).expect("each rollout once");
    let rounded = |assumed: &Assumed| {
        let rates = [
            assumed.s_sim,
            assumed.r_d,
            assumed.success_correlation,
            assumed.change_correlation,
            assumed.changed_correlation,
        ];
        (assumed.level, rates.map(|rate| (rate * 1e4).round() / 1e4))
    };
    let summary: Vec<_> = summary.iter().map(rounded).collect();
    assert_eq!(summary, Assumed::STUDENT.each_ref().map(rounded), "{summary:?}");
}
