use super::*;

const FILE: &str = r#"{
    "name": "drawers", "start": "initial-state", "prompt": "name", "seed": 7, "waits": 10,
    "budget": 300, "trials": 2,
    "suites": [
        {"name": "near", "bddl": "bddl/*.bddl", "states": "states/*.pruned_init",
         "tasks": ["KITCHEN_SCENE10_close_the_drawer",
            {"name": "open_it", "prompt": "open the drawer", "view": [0, 15, 100, 0, 350],
             "posture": [0, -0.2, 0, -2.4, 0, 2.2, 0.8], "noise": 30}]},
        {"name": "far", "bddl": "far/*.bddl", "states": "far/*.npz", "budget": 500,
         "tasks": ["push_it"]}
    ]
}"#;

#[test]
fn rows_have_the_rules_and_the_conditions_of_their_tasks() {
    let file = SuiteFile::from_json(FILE).expect("a suite file");
    let rows = file.rows();
    let ids: Vec<String> = rows.iter().map(|row| row.id.to_string()).collect();
    assert_eq!(
        ids,
        [
            "own/t0/own:near/i00",
            "own/t0/own:near/i01",
            "own/t1/own:near/i00",
            "own/t1/own:near/i01",
            "own/t2/own:far/i00",
            "own/t2/own:far/i01",
        ]
    );
    let task = rows[3].own.as_deref().expect("a task of a suite file");
    assert_eq!(task.folder, "suites/drawers");
    assert_eq!(task.bddl, "bddl/open_it.bddl");
    assert_eq!(task.states, "states/open_it.pruned_init");
    assert_eq!((task.start, task.seed), (Beginning::InitialState, 7));
    assert_eq!(task.changes.noise, Some(30));
    assert_eq!(task.changes.view, Some([0, 15, 100, 0, 350]));
    let instructions_and_steps = rows
        .iter()
        .step_by(2)
        .map(|row| (row.instruction.as_str(), row.settle_steps, row.max_steps));
    let expected =
        [("close the drawer", 10, 300), ("open the drawer", 10, 300), ("push it", 10, 500)];
    assert_eq!(instructions_and_steps.collect::<Vec<_>>(), expected);
    for row in rows {
        let text = serde_json::to_string(&row).expect("JSON");
        assert_eq!(serde_json::from_str::<ManifestRow>(&text).expect(&text), row);
        let outside = text.replace("suites/drawers", "../drawers");
        let error = serde_json::from_str::<ManifestRow>(&outside).expect_err(&outside);
        assert!(error.to_string().contains("without . and .."), "{error}");
    }
    let bddl_prompts = FILE.replace(r#""prompt": "name""#, r#""prompt": "bddl""#);
    let rows = SuiteFile::from_json(&bddl_prompts).expect("a suite file");
    let rows = rows.rows();
    assert_eq!(rows[0].instruction, "");
    assert_eq!(rows[2].instruction, "open the drawer");
}

#[test]
fn the_digest_is_of_the_content_without_the_number_of_trials() {
    let digest = |text: &str| SuiteFile::from_json(text).expect("a suite file").digest();
    let written = SuiteFile::from_json(FILE).expect("a suite file");
    let written = serde_json::to_string(&written).expect("JSON");
    assert_eq!(digest(&written), digest(FILE));
    let more_trials = FILE.replace(r#""trials": 2"#, r#""trials": 3"#);
    assert_eq!(digest(&more_trials), digest(FILE));
    let other_seed = FILE.replace(r#""seed": 7"#, r#""seed": 8"#);
    assert_ne!(digest(&other_seed), digest(FILE));
    let protocol = SuiteFile::from_json(FILE).expect("a suite file").protocol();
    assert_eq!(protocol, format!("drawers@{}", &digest(FILE)[..16]));
}

#[test]
fn malformed_files_are_refused_with_the_field_and_the_remedy() {
    #[track_caller]
    fn check(from: &str, to: &str, expected: &str) {
        let text = FILE.replacen(from, to, 1);
        assert_ne!(text, FILE, "{from}");
        let error = SuiteFile::from_json(&text).expect_err(to).to_string();
        assert!(error.contains(expected), "{error}");
    }
    check(r#""seed": 7,"#, "", "`seed`");
    check(r#""seed": 7"#, r#""seeds": 7"#, "no field `seeds`");
    check(r#""seed": 7"#, r#""seed": "#, "docs/FAMILY.md");
    check("initial-state", "middle", "`initial-state`");
    check(r#""drawers""#, r#""Drawers""#, "`name` is `Drawers`: write 1 to 31");
    check(r#""near""#, r#""unperturbed""#, "`suites[0].name`");
    check(r#""far""#, r#""near""#, "`suites[1].name` is `near`: another suite");
    check("bddl/*.bddl", "/bddl/*.bddl", "`suites[0].bddl`");
    check("states/*.", "../*.", "without . and ..");
    check("states/*.", "states/one.", "write * in place");
    check("open_it", "a/b", "`suites[0].tasks[1].name` is `a/b`: write the name");
    check("open the drawer", " ", "`suites[0].tasks[1].prompt` is empty");
    check("0, 350]", "0, 360]", "`suites[0].tasks[1].view`");
    check("-2.4, 0", "-24, 0", "`suites[0].tasks[1].posture`");
    check("-2.4, 0", "-2.4", "a task is its name, or a table");
    check(r#""noise": 30"#, r#""noise": 51"#, "write 1 to 50");
    check(r#""noise": 30"#, r#""sha256": "ab""#, "sha256sum");
    check(r#""trials": 2"#, r#""trials": 51"#, "`trials` is 51: write 1 to 50");
    check(r#""budget": 500"#, r#""budget": 0"#, "`suites[1].budget` is 0");
    check("open the drawer", r"open\nit", "at most 4096 bytes on one line");
    check(r#""push_it""#, r#""push_it", "push_it""#, "would count twice");
    let many = vec![r#""push_it""#; 255].join(",");
    check(r#""push_it""#, &many, "`suites` is 257 tasks: write 1 to 256");
}
