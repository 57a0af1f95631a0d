//! Campaigns that may stop early: recorded fields, and refused specifications.

use benchmark::{Axis, CampaignSpec, Design, ManifestRow, SpecError};
use serde_json::{Value, json};

fn spec(changes: &[(&str, Value)]) -> Value {
    let mut json = json!({
        "name": "demo",
        "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
        "tasks": ["libero_object"], "axes": ["camera", "robot"], "levels": ["L1", "L2"],
        "stop": {"rule": "width(I)<0.20"},
    });
    for (field, value) in changes {
        json[field] = value.clone();
    }
    json
}

fn imported(rows: &[ManifestRow]) -> Value {
    json!({
        "name": "imported",
        "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
        "rows": rows, "stop": {"rule": "I excludes 0"},
    })
}

fn read(json: &Value) -> Result<CampaignSpec, SpecError> {
    CampaignSpec::from_json(&json.to_string())
}

#[test]
fn a_rule_is_written_with_its_seed_and_does_not_change_the_version() {
    let stopping = read(&spec(&[])).expect("a specification");
    let text = serde_json::to_string(&stopping).expect("JSON");
    let stop = r#""stop":{"rule":"width(I) < 0.2","seed":0,"strata":"suites"}"#;
    assert!(text.contains(stop), "{text}");
    assert_eq!(CampaignSpec::from_json(&text).as_ref(), Ok(&stopping));
    let without_rule = read(&spec(&[("stop", Value::Null)])).expect("a specification");
    let text = serde_json::to_string(&without_rule).expect("JSON");
    assert!(!text.contains("stop"), "{text}");
    assert_eq!(stopping.version(), without_rule.version());
}

#[test]
fn a_rule_that_cannot_end_the_campaign_is_refused_with_the_remedy() {
    let check = |changes: &[(&str, Value)], expected: &str| {
        let error = read(&spec(changes)).expect_err(expected).to_string();
        assert!(error.contains(expected), "{error}");
    };
    let stop = |stop: Value| ("stop", stop);
    check(&[stop(json!({"rule": "width(difference) < 0.1"}))], "valid are S_sim, R_e, R_c, R_d, I");
    check(&[stop(json!({"rule": "soon"}))], "stop rule `soon`");
    check(&[stop(json!({"seed": 1}))], "`rule`");
    check(&[stop(json!({"rule": "I excludes 0", "strata": "x"}))], "`x`");
    check(&[stop(json!({"rule": "I excludes 0 for new tasks"}))], "M excludes X with X from");
    check(&[("axes", json!(["camera"]))], "two axes or more");
    check(&[("replicates", json!(3))], "with 3 `replicates`");
}

#[test]
fn imported_configurations_need_all_conditions_at_all_levels() {
    let rows = Design {
        axes: vec![Axis::Camera, Axis::Robot],
        tasks: Design::v0_1().tasks[..2].to_vec(),
        configs: vec![0, 1],
        ..Design::v0_1()
    };
    let rows = rows.expand().expect("rows");
    assert!(read(&imported(&rows)).is_ok());
    let is_left_out = |row: &&ManifestRow| row.id.to_string() != "spatial/t1/robot/L2/c01";
    let fewer: Vec<ManifestRow> = rows.iter().filter(is_left_out).cloned().collect();
    let error = read(&imported(&fewer)).expect_err("a rollout is missing");
    let error = error.to_string();
    assert!(error.contains("spatial/t1/robot/L2/c01 is not"), "{error}");
    let nominal: Vec<ManifestRow> =
        rows.into_iter().filter(|row| row.id.config().is_none()).collect();
    let error = read(&imported(&nominal)).expect_err("nothing is perturbed");
    assert!(error.to_string().contains("two axes or more"), "{error}");
}
