mod coverage;
mod curves;
mod one_ray;

use std::collections::BTreeSet;

use benchmark::{RolloutId, Thresholds};
use paired::adaptive::radii::Measurement;
use paired::{Outcome, Record};

fn thresholds(tolerance: f64, max_radius: f64) -> Thresholds {
    Thresholds {
        campaign: "first".to_owned(),
        conditions: Vec::new(),
        tolerance,
        max_radius,
        budget: None,
        seed: 0,
    }
}

/// Returns a record of replicate 0. Configuration j begins at initial state j.
fn record(id: RolloutId, outcome: Outcome) -> Record {
    Record { id, init_id: id.number(), replicate: 0, outcome }
}

/// Runs the planned rollouts until none is left, and returns their records.
fn measure(
    source: &[Record],
    thresholds: &Thresholds,
    outcome: impl Fn(RolloutId) -> Outcome,
) -> Vec<Record> {
    let mut ids: BTreeSet<RolloutId> = source.iter().map(|record| record.id).collect();
    let mut further: Vec<Record> = Vec::new();
    loop {
        let plan = Measurement::of(source, &further, thresholds).plan();
        if plan.is_empty() {
            return further;
        }
        for (ray, level) in plan {
            let id = RolloutId::perturbed(ray.task, ray.condition, level, ray.config);
            let id = id.expect("a perturbed level");
            assert!(ids.insert(id), "{id} was planned twice");
            further.push(record(id, outcome(id)));
        }
    }
}
