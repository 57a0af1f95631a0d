use super::*;
use crate::condition::Condition;
use crate::design::Nominal;
use crate::level::Level;
use crate::manifest;

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

#[test]
fn the_files_tasks_take_every_axis_as_liberos_do() {
    let design = |axes: &[Axis]| Design {
        axes: axes.to_vec(),
        levels: vec![Level::L1, Level::L2],
        configs: vec![0, 4, 12],
        nominal: Nominal::Eval,
        ..Design::v0_1()
    };
    let file = SuiteFile::from_json(FILE).expect("a suite file");
    let rows = file.perturbed(design(&Axis::METRIC)).expect("rows");
    let of_libero = Design { tasks: TaskRef::all().take(3).collect(), ..design(&Axis::METRIC) };
    let of_libero = of_libero.expand().expect("rows").into_iter().map(|row| row.perturbation);
    let is_perturbed = |row: &&ManifestRow| row.id.config().is_some();
    let perturbed: Vec<_> = rows.iter().filter(is_perturbed).map(|row| row.perturbation).collect();
    let of_libero = of_libero.filter(|perturbation| !perturbation.axes().is_empty());
    assert_eq!(perturbed, of_libero.collect::<Vec<_>>());
    let nominal = rows.iter().filter(|row| row.id.condition() == Condition::of(AxisSet::EMPTY));
    let nominal: BTreeSet<_> = nominal.map(|row| (row.id.task(), row.init_id)).collect();
    assert_eq!(rows.len(), nominal.len() + 3 * 3 * 2 * 6);
    for row in &rows {
        assert!(row.init_id < 2 && nominal.contains(&(row.id.task(), row.init_id)), "{}", row.id);
        let plain = &file.rows()[2 * usize::from(row.id.task().index())];
        let own = row.own.as_deref().expect("a task").clone();
        assert_eq!(Some(OwnTask { suite: String::new(), ..own }), plain.own.as_deref().cloned());
        assert_eq!((row.suite_name(), &row.protocol), (plain.suite_name(), &plain.protocol));
        assert_eq!((&row.instruction, row.max_steps), (&plain.instruction, plain.max_steps));
    }
    assert_eq!(rows[1].id.to_string(), "own/t0/camera/L1/c00");
    for row in &rows {
        assert_eq!(file.row_of(row.id).as_ref(), Ok(row));
    }
    assert!(file.row_of("own/t3/camera/L2/c00".parse().expect("an id")).is_err());
    assert_eq!(manifest::parse(&manifest::to_text(&rows)), Ok(rows));

    let error = file.perturbed(design(&Axis::ALL)).expect_err("no paraphrases").to_string();
    assert!(error.contains("own/0 has `close the drawer`"), "{error}");
    let names = ["close_the_drawer", "push_it"].into_iter();
    let text = names.fold(FILE.replace("open the drawer", "turn on the stove"), |text, name| {
        text.replace(name, "turn_on_the_stove")
    });
    let file = SuiteFile::from_json(&text).expect("a suite file");
    let rows = file.perturbed(design(&Axis::ALL)).expect("rows");
    let all = rows.iter().find(|row| row.id.condition() == Condition::of(AxisSet::ALL));
    let all = all.expect("a simultaneous rollout");
    let stove = "goal/t7/simultaneous/L1/c00".parse().map(crate::row_of);
    assert_eq!(all.instruction, stove.expect("an id").expect("a row").instruction);
    for row in rows.iter().filter(|row| row.id.to_string().starts_with("own/t0/")) {
        if row.id.level() == all.id.level() && row.id.config() == Some(0) {
            assert_eq!(all.only(row.axes()).expect("axes").instruction, row.instruction);
            assert_eq!(row.canonical_instruction(), "turn on the stove");
        }
    }
}
