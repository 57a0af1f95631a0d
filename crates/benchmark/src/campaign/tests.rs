use super::*;
use crate::axis::Axis;
use crate::latency::delay_at;
use crate::perturbation::Perturbation;
use crate::rollout_id::RolloutId;
use crate::row_of;

fn spec(changes: &[(&str, serde_json::Value)]) -> Result<CampaignSpec, SpecError> {
    let mut json = serde_json::json!({
        "name": "demo",
        "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
        "tasks": ["libero_object/1", "libero_object/0", "libero_object/1"],
        "axes": ["sensor", "camera"],
        "levels": ["L1"],
        "nominal": "eval",
    });
    for (field, value) in changes {
        json[field] = value.clone();
    }
    CampaignSpec::from_json(&json.to_string())
}

#[test]
fn a_specification_is_parsed_with_sorted_lists() {
    let spec = spec(&[]).expect("a specification");
    let design = design(&spec);
    assert_eq!(design.tasks.len(), 2);
    assert_eq!(design.axes, [Axis::Camera, Axis::Sensor]);
    assert_eq!(design.configs, (0..10).collect::<Vec<_>>());
    let text = serde_json::to_string(&spec).expect("JSON");
    assert_eq!(CampaignSpec::from_json(&text).expect("reads back"), spec);
}

fn design(spec: &CampaignSpec) -> &Design {
    match &spec.rollouts {
        Rollouts::Design(design) => design,
        _ => panic!("{spec:?}"),
    }
}

#[test]
fn an_execution_model_other_than_wait_is_written_and_changes_the_version() {
    let waiting = spec(&[]).expect("a specification");
    let text = serde_json::to_string(&waiting).expect("JSON");
    assert!(!text.contains("execution"), "{text}");
    let mut versions = vec![waiting.version()];
    for model in ["hold:4", "overlap:4", "overlap:4,rtc", "overlap:3*812+4*188"] {
        let spec = spec(&[("execution", model.into())]).expect("a specification");
        let text = serde_json::to_string(&spec).expect("JSON");
        assert!(text.contains(&format!(r#""execution":"{model}""#)), "{text}");
        assert_eq!(CampaignSpec::from_json(&text).expect("reads back"), spec);
        versions.push(spec.version());
    }
    for version in &versions {
        assert_eq!(version.to_string().parse().as_ref(), Ok(version));
    }
    let distinct: std::collections::BTreeSet<_> = versions.iter().collect();
    assert_eq!(distinct.len(), versions.len());
    let waits = spec(&[("execution", "wait".into())]).expect("a specification");
    assert_eq!(waits, waiting);
    let error = spec(&[("execution", "overlap:4000".into())]).expect_err("too long");
    assert!(error.to_string().contains("overlap:N"), "{error}");
}

fn imported(rows: &[ManifestRow], model: Option<&str>) -> Result<CampaignSpec, SpecError> {
    let mut json = serde_json::json!({
        "name": "imported",
        "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
        "rows": rows,
    });
    if let Some(model) = model {
        json["execution"] = model.into();
    }
    CampaignSpec::from_json(&json.to_string())
}

#[test]
fn rows_replace_a_design() {
    let rows = Design::v0_1().expand().expect("rows");
    let row = &rows[..1];
    let mut json = serde_json::json!({
        "name": "imported",
        "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
        "rows": row,
    });
    let spec = CampaignSpec::from_json(&json.to_string()).expect("a specification");
    assert_eq!(spec.rollouts, Rollouts::Rows(row.to_vec()));
    let text = serde_json::to_string(&spec).expect("JSON");
    assert_eq!(CampaignSpec::from_json(&text).expect("reads back"), spec);

    json["configs"] = serde_json::json!([0]);
    let error = CampaignSpec::from_json(&json.to_string()).expect_err("two sources of rollouts");
    assert!(error.to_string().contains("`configs` and `rows`"), "{error}");
}

#[test]
fn latency_rows_exclude_execution_models_other_than_wait() {
    let row = |id: &str| crate::row_of(id.parse().expect("an id")).expect("a row");
    let [late, nominal] = ["goal/t0/latency/L2/c00", "goal/t0/nominal/i06"].map(row);
    let holding = nominal.clone().under(&"hold:2".parse().expect("a model"));
    let waiting = [late.clone(), nominal];
    imported(&waiting, None).expect("a specification");
    for (rows, model) in [(&waiting, Some("overlap:8")), (&[late, holding], None)] {
        let error = imported(rows, model).expect_err("two models");
        assert!(matches!(error, SpecError::Latency { .. }), "{error}");
    }
}

#[test]
fn a_campaign_has_the_execution_model_of_its_manifest() {
    let late = spec(&[("execution", "overlap:4".into())]).expect("a specification");
    let rows = late.expand().expect("rows");
    assert!(rows.iter().all(|row| row.execution == late.execution));
    let text = manifest::to_text(&rows);
    let lines = text.matches(r#""execution":"overlap:4""#).count();
    assert_eq!(lines, rows.len());
    assert_eq!(manifest::parse(&text), Ok(rows.clone()));

    let read = imported(&rows, None).expect("a specification");
    assert_eq!(read.execution, late.execution);
    assert_eq!(read.version(), DesignVersion::of_manifest(&rows));
    assert_eq!(imported(&rows, Some("overlap:4")), Ok(read.clone()));
    let error = imported(&rows, Some("hold:2")).expect_err("another model");
    for part in ["`execution` is hold:2", "`overlap:4`", "remove `execution`"] {
        assert!(error.to_string().contains(part), "{error}");
    }
    let without_model: Vec<ManifestRow> =
        rows.iter().map(|row| row.clone().under(&Execution::Wait)).collect();
    let given = imported(&without_model, Some("overlap:4")).expect("a specification");
    assert_eq!(given.expand().expect("rows"), rows);
    assert_eq!(given.version(), read.version());
    assert_ne!(imported(&without_model, None).expect("a specification").version(), read.version());

    let mixed = [rows[0].clone(), without_model[1].clone()];
    let error = imported(&mixed, None).expect_err("two models");
    for part in ["execution model `wait`", "`overlap:4` in line 1"] {
        assert!(error.to_string().contains(part), "{error}");
    }
}

#[test]
fn latency_is_a_further_axis_that_combinations_exclude() {
    let axes = serde_json::json!(["camera", "robot", "latency"]);
    let levels = serde_json::json!(["L0", "L1", "L3", "r6"]);
    let late = [("axes", axes), ("levels", levels)];
    let late = spec(&late).expect("a specification");
    let text = serde_json::to_string(&late).expect("JSON");
    assert!(text.contains(r#""axes":["camera","robot","latency"]"#), "{text}");
    assert_eq!(CampaignSpec::from_json(&text), Ok(late.clone()));
    let rows = late.expand().expect("rows");
    let is_late = |row: &&ManifestRow| row.id.condition().sets_execution();
    let (latency, others): (Vec<&ManifestRow>, Vec<&ManifestRow>) = rows.iter().partition(is_late);
    // Two tasks, ten configurations, three levels: the placebo level has no latency rollouts.
    assert_eq!(latency.len(), 2 * 10 * 3);
    assert!(others.iter().all(|row| row.execution.is_wait()));
    for row in &latency {
        let steps = delay_at(row.id.level()).expect("a delay");
        assert_eq!(row.execution.to_string(), format!("overlap:{steps}"));
        assert_eq!(row.perturbation, Perturbation::default());
        let camera = RolloutId::perturbed(
            row.id.task(),
            Condition::Single(Axis::Camera),
            row.id.level(),
            row.id.number(),
        );
        let camera = camera.expect("an id");
        let camera = others.iter().find(|other| other.id == camera);
        assert_eq!(camera.expect("a row").init_id, row.init_id);
        assert_eq!(row_of(row.id).expect("a row"), **row);
    }
    let combined = others.iter().find(|row| row.id.condition() == Condition::Simultaneous);
    let camera_and_robot = AxisSet::from_iter([Axis::Camera, Axis::Robot]);
    assert_eq!(combined.expect("a row").axes(), camera_and_robot);
    let other_rows: Vec<ManifestRow> = others.into_iter().cloned().collect();
    let axes = serde_json::json!(["camera", "robot"]);
    let levels = serde_json::json!(["L0", "L1", "L3", "r6"]);
    let without_latency = spec(&[("axes", axes), ("levels", levels)]).expect("a specification");
    assert_eq!(
        without_latency.expand().expect("rows"),
        other_rows,
        "the other rows are the same as without latency"
    );
    assert_ne!(late.version(), without_latency.version());

    // In a manifest, latency rows have their own execution models.
    let text = manifest::to_text(&rows);
    assert_eq!(manifest::parse(&text), Ok(rows.clone()));
    let wrong = text.replace(r#""execution":"overlap:4""#, r#""execution":"overlap:2""#);
    let error = manifest::parse(&wrong).expect_err("a delay that differs from its level's");
    assert!(error.to_string().contains("its level: overlap:4"), "{error}");
}

#[test]
fn delays_of_fractional_steps_or_with_another_execution_model_are_refused() {
    let refused = |axes: serde_json::Value, levels: serde_json::Value, model: &str| {
        let changes = [("axes", axes), ("levels", levels), ("execution", model.into())];
        spec(&changes).expect_err("refused").to_string()
    };
    let latency = serde_json::json!(["latency"]);
    let error = refused(latency.clone(), serde_json::json!(["r3"]), "wait");
    assert!(error.contains("half the radius in control steps"), "{error}");
    let error = refused(latency, serde_json::json!(["L1"]), "hold:2");
    assert!(error.contains("axis `latency` with `execution` hold:2"), "{error}");
    for id in ["goal/t0/latency/L0/c00", "goal/t0/latency/r3/c00"] {
        assert!(row_of(id.parse().expect("an id")).is_err(), "{id}");
    }
    assert!("goal/t0/camera+latency/L1/c00".parse::<RolloutId>().is_err());
}

#[test]
fn a_purpose_has_defaults_and_starts_without_rows() {
    let json = |purpose: serde_json::Value| {
        serde_json::json!({
            "name": "why",
            "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
            "rows": [],
            "purpose": purpose,
        })
    };
    let explanation =
        json(serde_json::json!({"explanation": {"campaign": "first", "budget": 200}}));
    let thresholds = json(serde_json::json!({"thresholds": {"campaign": "first"}}));
    for json in [&explanation, &thresholds] {
        let spec = CampaignSpec::from_json(&json.to_string()).expect("a specification");
        assert_eq!(spec.expand(), Ok(Vec::new()));
        assert_eq!(spec.purpose.as_ref().map(Purpose::source), Some("first"));
        assert!(spec.version().as_str().starts_with("purpose-"));
        let text = serde_json::to_string(&spec).expect("JSON");
        assert_eq!(CampaignSpec::from_json(&text).expect("reads back"), spec);
        let is_defaulted = text.contains(r#""tolerance":0.5,"max_radius":16.0"#);
        assert_eq!(is_defaulted, text.contains("thresholds"), "{text}");
    }
    let row = crate::row_of("goal/t0/nominal/i06".parse().expect("an id")).expect("a row");
    for (path, value, expected) in [
        ("/realisation", "reference".into(), "write matched"),
        ("/levels", serde_json::json!(["L2"]), "`levels` and `rows`"),
        ("/rows", serde_json::json!([row]), "write `rows` []"),
        ("/stop", serde_json::json!({"rule": "I excludes 0"}), "two axes or more"),
        ("/purpose/thresholds/campaign", "".into(), "`purpose.campaign` is empty"),
        ("/purpose/thresholds/tolerance", 0.into(), "tolerance` is 0, valid are 0.01 to 100"),
        ("/purpose/thresholds/max_radius", 101.into(), "is 101, valid are 2 to 100"),
    ] {
        let mut json = thresholds.clone();
        let (parent, field) = path.rsplit_once('/').expect("a path");
        json.pointer_mut(parent).expect("an object")[field] = value;
        let error = CampaignSpec::from_json(&json.to_string()).expect_err(path).to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn imported_rows_are_checked_like_those_of_a_file() {
    let check = |rows: &[ManifestRow], expected: &str| {
        let json = serde_json::json!({
            "name": "imported",
            "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
            "rows": rows,
        });
        let error = CampaignSpec::from_json(&json.to_string()).expect_err(expected);
        assert!(error.to_string().contains(expected), "{error}");
    };
    let rows = Design::v0_1().expand().expect("rows");
    check(&[], "the manifest has no rows");
    check(&[rows[0].clone(), rows[0].clone()], "line 2: spatial/t0/nominal/i43 is already");
    let mut too_strong = rows[1].clone();
    too_strong.perturbation = rows[8].perturbation;
    check(&[too_strong], "have radius");
}

#[test]
fn errors_for_invalid_names_and_numbers_list_the_valid_ones() {
    let check = |field: &str, value: serde_json::Value, expected: &str| {
        let error = spec(&[(field, value)]).expect_err(field).to_string();
        assert!(error.contains(expected), "{error}");
    };
    let json = |text: &str| serde_json::from_str(text).expect("JSON");
    check("tasks", json(r#"["libero_goat"]"#), "suite `libero_goat`: valid are libero_spatial");
    check("tasks", json(r#"["libero_goal/10"]"#), "libero_goal/0 to libero_goal/9");
    check("tasks", json("[]"), "`tasks` is empty");
    check("axes", json(r#"["camrea"]"#), "axis `camrea`: valid are camera");
    check("axes", json("[]"), "go together");
    check("levels", json(r#"["L4"]"#), "level `L4`: valid are L0, L1, L2, L3");
    check("placebo_radius", json("0.05"), "add L0 to `levels`");
    check("placebo_radius", json("0"), "`placebo_radius` is 0, valid are");
    check("directions", json(r#""mine""#), "`mine` is not valid; write");
    check("levels", json("null"), "the field `levels` is missing");
    check("configs", json("[1000]"), "`configs` has 1000, valid are 0 to 999");
    check("nominal", json(r#""some""#), "`some` is not valid; write");
    check("replicates", json("0"), "`replicates` has 0, valid are 1 to 100");
    check("colour", json("1"), "there is no field `colour`");
    check("policy", json(r#"{"name": "p", "endpoint": "here"}"#), "http://HOST:PORT");
    check("realisation", json(r#""matchd""#), "valid are matched, reference");
}

#[test]
fn rows_of_a_suite_file_are_those_of_a_campaign_in_the_files_order() {
    let file = crate::SuiteFile::from_json(
        r#"{"name": "drawers", "start": "initial-state", "prompt": "name", "seed": 0, "waits": 10,
            "budget": 300, "trials": 2, "suites": [
                {"name": "near", "bddl": "*.bddl", "states": "*.npz", "tasks": ["b", "a"]},
                {"name": "far", "bddl": "*.bddl", "states": "*.npz",
                 "tasks": [{"name": "c", "noise": 6, "posture": [0, 0, 0, 0, 0, 0, 0]}]}]}"#,
    );
    let rows = file.expect("a suite file").rows();
    let read = imported(&rows, None).expect("a specification");
    assert_eq!(read.expand(), Ok(rows.clone()));
    let protocol = read.rollouts.protocol().expect("a protocol");
    assert!(protocol.starts_with("drawers@"), "{protocol}");
    let nominal = crate::row_of("goal/t0/nominal/i06".parse().expect("an id")).expect("a row");
    let error = imported(&[&rows[..], &[nominal]].concat(), None).expect_err("two benchmarks");
    for part in ["goal/t0/nominal/i06: no protocol, but protocol `drawers@", "in line 1: put"] {
        assert!(error.to_string().contains(part), "{error}");
    }
    // A worker runs rows without their suite file, whose checks they pass too.
    for (field, value, expected) in [
        ("bddl", serde_json::json!("../c.bddl"), "`own.bddl` is `../c.bddl`: write a relative"),
        ("changes", serde_json::json!({"noise": 51}), "`own.changes.noise` is 51: write 1 to 50"),
    ] {
        let mut row = serde_json::to_value(&rows[4]).expect("JSON");
        row["own"][field] = value;
        let error = serde_json::from_value::<ManifestRow>(row).expect_err(expected).to_string();
        assert!(error.contains(expected), "{error}");
    }
    let error = crate::row_of(rows[0].id).expect_err("a row of a suite file");
    assert!(error.to_string().contains("`worker rollout` with --suite-file"), "{error}");
}

#[test]
fn an_endpoint_is_the_address_of_a_server_and_holds_no_password() {
    let check = |endpoint: &str| {
        let json = serde_json::json!({
            "name": "a", "policy": {"name": "expert", "endpoint": endpoint},
            "tasks": ["libero_object/0"], "axes": ["camera"], "levels": ["L1"], "configs": [0],
        });
        CampaignSpec::from_json(&json.to_string())
    };
    for valid in ["http://h:1", "grpc://h", "https://[::1]:7/", "grpcs://a-b.c_d:1"] {
        check(valid).expect(valid);
    }
    for invalid in [
        "h:1",
        "://h",
        "ftp://h",
        "file:///etc/passwd",
        "http://",
        "http://h:1\r\nX: y",
        "http://h/path",
        "http://me:secret@h:1",
    ] {
        let error = check(invalid).expect_err(invalid).to_string();
        assert!(error.contains("grpc://HOST:PORT") && !error.contains("secret"), "{error}");
    }
}
