//! Compares the design with the published outcomes of a policy: the same rollouts from the same
//! initial states. If the file of outcomes is missing, the test prints its path and passes.

use std::collections::BTreeMap;
use std::path::Path;

use benchmark::{Design, ManifestRow, RolloutId};
use serde_json::Value;

#[test]
fn the_published_rollouts_are_those_of_the_design() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/libero-ctrl-v0.1/openvla_oft_eval/rollouts.jsonl");
    let Ok(text) = std::fs::read_to_string(&file) else {
        println!("skipped: {} is not here", file.display());
        return;
    };
    let rows = Design::v0_1().expand().expect("rows");
    let perturbed = rows.iter().filter(|row| row.id.config().is_some());
    let mut rows: BTreeMap<RolloutId, &ManifestRow> = perturbed.map(|row| (row.id, row)).collect();
    for line in text.lines() {
        let published: Value = serde_json::from_str(line).expect("JSON");
        let id = published["rollout_id"].as_str().expect("an id");
        let row = rows.remove(&id.parse().expect("an id"));
        let row = row.unwrap_or_else(|| panic!("{id} is not in the design, or published twice"));
        assert_eq!(row.id.published(), id);
        assert_eq!(published["init_id"], row.init_id, "{id}");
        assert_eq!(published["config"], row.init_slot, "{id}");
    }
    assert!(rows.is_empty(), "{} rows are not published", rows.len());
}
