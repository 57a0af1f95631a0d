//! A campaign of LIBERO's family through real processes, compared with `worker rollout`.

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use benchmark::Benchmark;
use scene::Sources;
use serde_json::Value;
use tests::outcome::{Outcomes, alone, stored};
use tests::programs::{Campaigns, Process, program};

/// One variant of each dimension that needs LIBERO's own files only, and another of the camera.
const VARIANTS: [&str; 4] = [
    "put_the_bowl_on_the_plate_view_0_0_181_0_0_initstate_0",
    "put_the_bowl_on_the_plate_view_0_0_100_0_0_initstate_19",
    "put_the_bowl_on_the_plate_view_0_0_100_0_0_initstate_0_noise_30",
    "put_the_bowl_on_the_plate_view_0_0_190_0_0_initstate_0",
];
/// Ids of the rollouts of a campaign of [`VARIANTS`], including the task's unperturbed rollout.
const IDS: [&str; 5] = [
    "goal/t8/plus:initstate_19/i00",
    "goal/t8/plus:noise_30/i00",
    "goal/t8/plus:unperturbed/i00",
    "goal/t8/plus:view_0_0_181_0_0/i00",
    "goal/t8/plus:view_0_0_190_0_0/i00",
];
/// Variants with task files of their own, and their ids.
const WITH_OWN_FILES: [(&str, &str); 2] = [
    (
        "put_the_bowl_on_the_plate_language_1_view_0_0_100_0_0_initstate_0",
        "goal/t8/plus:language_1/i00",
    ),
    (LAYOUT, "goal/t8/plus:level1_sample1/i00"),
];
const LAYOUT: &str = "put_the_bowl_on_the_plate_moved_level1_sample1";

fn creation<'a>(campaigns: &'a Campaigns, policy: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let endpoint = campaigns.gateway.url.as_str();
    let mut arguments = vec!["campaign", "create", "--name", "plus", "--policy", policy];
    arguments.extend(["--endpoint", endpoint, "--suite", "libero-plus"]);
    arguments.extend(more);
    arguments
}

/// Returns the variants whose files this machine has, and the ids of the campaign's rollouts.
fn variants(test: &str) -> (Vec<&'static str>, BTreeSet<String>) {
    let mut names = VARIANTS.to_vec();
    let mut ids: BTreeSet<String> = IDS.iter().map(ToString::to_string).collect();
    match scene::has_task_files(Benchmark::Plus, &tests::files::sources()) {
        false => println!("skipped in part {test}: no task files of LIBERO-Plus"),
        true => {
            names.extend(WITH_OWN_FILES.map(|(name, _)| name));
            ids.extend(WITH_OWN_FILES.map(|(_, id)| id.to_owned()));
        }
    }
    (names, ids)
}

/// Asserts that `worker rollout` has the outcomes of a campaign.
fn assert_same_alone(campaigns: &Campaigns, outcomes: &Outcomes, more: &[&str]) {
    for (id, outcome) in outcomes {
        let more = [&["--assets", "primitives"], more].concat();
        assert_eq!(&alone(&campaigns.gateway.url, id, &more), outcome, "{id}");
    }
}

#[tokio::test]
async fn a_campaign_of_variants_has_the_outcomes_of_worker_rollout() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let campaigns = Campaigns::start(&data);
    let (names, ids) = variants("a_campaign_of_variants_has_the_outcomes_of_worker_rollout");
    let joined = names.join(",");
    let created = campaigns.succeed(&creation(&campaigns, "student", &["--variant", &joined]));
    assert!(created.contains(&format!("{} rollouts", ids.len())), "{created}");
    let _worker = Process::worker(&campaigns.coordinator.url, 2, "primitives");
    campaigns.wait_for_commits("plus", None);
    let export = campaigns.succeed(&["export", "plus", "--format", "jsonl"]);
    let mut prompts = HashMap::new();
    for line in export.lines() {
        let row: Value = serde_json::from_str(line).expect("JSON");
        assert_eq!(row["protocol"], "plus-official");
        assert_eq!(row["axis"], "variant");
        prompts.insert(row["rollout_id"].clone(), row["prompt"].clone());
    }
    let outcomes = stored(&data, "plus").await;
    for (id, outcome) in &outcomes {
        assert_eq!(prompts[&Value::from(id.as_str())], outcome.prompt, "{id}");
        let shown = campaigns.succeed(&["jobs", "plus", id]);
        let line = format!("  prompt         {}\n", outcome.prompt);
        assert!(shown.contains(&line), "{shown}");
    }
    assert!(outcomes.keys().eq(ids.iter()), "{outcomes:?}");
    assert_same_alone(&campaigns, &outcomes, &[]);
    // The changes reached the simulator: no two variants have the same first frames. Variants of
    // the language are left out, because another instruction changes no picture.
    let visual = outcomes.iter().filter(|(id, _)| !id.contains("language"));
    let frames: BTreeSet<&String> =
        visual.clone().map(|(_, outcome)| &outcome.digests[2]).collect();
    assert_eq!(frames.len(), visual.count(), "{outcomes:?}");

    let report = campaigns.succeed(&["report", "plus"]);
    for word in ["under protocol plus-official", "unperturbed", "camera", "robot", "noise"] {
        assert!(report.contains(word), "no `{word}` in the report:\n{report}");
    }
    assert!(report.lines().all(|line| line.chars().count() <= 80), "{report}");
    assert!(!report.contains("R_e"), "{report}");
    let json = campaigns.succeed(&["report", "plus", "--json"]);
    let json: Value = serde_json::from_str(&json).expect("JSON");
    let all = &json["family"]["all"];
    let count = Value::from(names.len());
    assert_eq!((&all["rollouts"], &all["pairs"]), (&count, &count));
    let perturbed = outcomes.iter().filter(|(id, _)| !id.contains("unperturbed"));
    let successes = perturbed.filter(|(_, outcome)| outcome.success).count();
    assert_eq!(all["successes"], successes);
    let groups = json["family"]["groups"].as_array().map(Vec::len);
    // Two of the variants change the camera.
    assert_eq!(groups, Some(names.len() - 1));

    // A variant takes LIBERO-CTRL's axes as a task of a suite file does.
    let design = ["--variant", VARIANTS[0], "--axes", "camera", "--configs", "0"];
    let mut perturbed = creation(&campaigns, "student", &design);
    perturbed[3] = "perturbed";
    campaigns.succeed(&perturbed);
    campaigns.wait_for_commits("perturbed", None);
    let perturbed = stored(&data, "perturbed").await;
    assert!(perturbed.keys().eq(["own/t0/camera/L2/c00", "own/t0/nominal/i00"]));
    let released = outcomes.values().find(|outcome| {
        let [scene, state, _] = &outcome.digests;
        perturbed.values().all(|of| (&of.digests[0], &of.digests[1]) == (scene, state))
    });
    assert!(released.is_some(), "{perturbed:?}");

    let twice = campaigns.call(&["report", "plus", "plus"]);
    let errors = String::from_utf8_lossy(&twice.stderr);
    assert!(errors.contains("never pooled"), "{errors}");
    let checked = campaigns.succeed(&["campaign", "status", "plus"]);
    assert!(checked.contains("finished"), "{checked}");
}

/// Creates a folder of links to the sources, without a benchmark's task files.
fn sources_without(benchmark: Benchmark, folder: &Path) {
    let sources = tests::files::sources();
    let left_out = Sources::family(sources.dir(), benchmark);
    std::fs::create_dir(folder).expect("a folder");
    for entry in std::fs::read_dir(sources.dir()).expect("the sources") {
        let entry = entry.expect("an entry");
        if !left_out.starts_with(entry.path()) {
            let link = folder.join(entry.file_name());
            std::os::unix::fs::symlink(entry.path(), link).expect("a link");
        }
    }
}

/// Regression: a worker repeatedly claimed the rollout that it cannot run, and waited between the
/// claims.
#[test]
fn a_worker_without_the_task_files_gets_other_rollouts_until_they_are_fetched() {
    let test = "a_worker_without_the_task_files_gets_other_rollouts_until_they_are_fetched";
    let folder = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::start(&folder.path().join("data"));
    let variants = format!("{LAYOUT},{}", VARIANTS[0]);
    campaigns.succeed(&creation(&campaigns, "noop", &["--variant", &variants]));
    let (log, sources) = (folder.path().join("log"), folder.path().join("sources"));
    sources_without(Benchmark::Plus, &sources);
    let mut command = Command::new(program("worker"));
    command.args(["--connect", &campaigns.coordinator.url, "--slots", "1"]);
    command.args(["--assets", "primitives", "--sources"]).arg(&sources);
    let log_file = std::fs::File::create(&log).expect("a file");
    let _worker = Process::start(command.stderr(log_file));
    // The unperturbed rollout and that of the camera need LIBERO's files only.
    campaigns.wait_for_commits("plus", Some(2));
    let remedy = "worker assets fetch --suite libero-plus";
    let start = Instant::now();
    while !std::fs::read_to_string(&log).expect("the log").contains(remedy) {
        assert!(start.elapsed() < Duration::from_secs(120), "no remedy in the log");
        std::thread::sleep(Duration::from_millis(200));
    }
    let shown = ["jobs", "plus", "goal/t8/plus:level1_sample1/i00"];
    let layout = campaigns.succeed(&shown);
    assert!(layout.contains("attempts       0,"), "never leased: {layout}");
    let report = campaigns.succeed(&["report", "plus", "--json"]);
    let report: Value = serde_json::from_str(&report).expect("JSON");
    let counts = ["missing", "quarantined"].map(|name| report["family"][name].clone());
    assert_eq!(counts, [1, 0].map(Value::from));
    assert_eq!(report["family"]["unperturbed"]["rollouts"], 1);

    let complete = tests::files::sources();
    if !scene::has_task_files(Benchmark::Plus, &complete) {
        println!("skipped in part {test}: no task files of LIBERO-Plus");
        return;
    }
    let fetched = Sources::family(complete.dir(), Benchmark::Plus);
    let link = sources.join(Benchmark::Plus.name());
    std::os::unix::fs::symlink(fetched, link).expect("a link");
    campaigns.wait_for_commits("plus", None);
}

#[test]
fn invalid_campaigns_and_commands_for_variants_are_refused_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::start(&folder.path().join("data"));
    for (more, expected) in [
        (&["--dimension", "light"][..], "choose other rollouts"),
        (&["--dimension", "light,camera"], "Give --runnable"),
        (&["--protocol", "pro-official"], "another benchmark's"),
        (&["--protocol", "plus"], "valid are plus-official"),
        (&["--dimension", "sound"], "valid are background"),
        (&["--dimension", "noise", "--trials", "3"], "leave it out"),
        (&["--dimension", "noise", "--stop", "I excludes 0"], "or remove `stop`"),
    ] {
        let refused = campaigns.call(&creation(&campaigns, "noop", more));
        let errors = String::from_utf8_lossy(&refused.stderr);
        assert!(!refused.status.success(), "{more:?}");
        assert!(errors.contains(expected), "{more:?}: {errors}");
    }
    let noise = ["--dimension", "noise", "--suites", "libero_goal"];
    campaigns.succeed(&creation(&campaigns, "noop", &noise));
    for arguments in
        [&["explain", "plus", "--create"][..], &["report", "plus", "--table", "table.csv"]]
    {
        let refused = campaigns.call(arguments);
        let errors = String::from_utf8_lossy(&refused.stderr);
        assert!(!refused.status.success(), "{arguments:?}");
        assert!(errors.contains("LIBERO-CTRL"), "{arguments:?}: {errors}");
    }
    let refused = campaigns.call(&["thresholds", "plus", "--create"]);
    assert!(!refused.status.success(), "thresholds of variants");
}

/// Returns the path of a checkout of LIBERO-Para; `None`, after a message, if there is none.
fn para_checkout(test: &str) -> Option<PathBuf> {
    let checkout = std::env::var_os("ROLLOUT_PARA").map(PathBuf::from);
    if checkout.is_none() {
        println!("skipped {test}: ROLLOUT_PARA names no checkout of LIBERO-Para");
    }
    checkout
}

fn fetch(sources: &Path, more: &[&str]) -> Output {
    let mut command = Command::new(program("worker"));
    command.args(["assets", "fetch", "--sources"]).arg(sources);
    let fetched = command.arg("--suite").args(more).output();
    fetched.expect("the worker runs")
}

#[test]
fn the_sentences_of_libero_para_come_from_a_checkout_only() {
    let folder = tempfile::tempdir().unwrap();
    let sources = folder.path().join("sources");
    sources_without(Benchmark::Para, &sources);
    let empty = folder.path().to_str().expect("UTF-8");
    for (more, expected) in [
        (&["libero-para"][..], "no package index has them; run `git clone"),
        (&["libero-para", "--checkout", empty], "4093 of 4093 files are missing"),
        (&["libero-pro", "--checkout", empty], "leave --checkout out"),
    ] {
        let refused = fetch(&sources, more);
        let errors = String::from_utf8_lossy(&refused.stderr);
        assert!(!refused.status.success(), "{more:?}");
        assert!(errors.contains(expected), "{more:?}: {errors}");
    }
    let mut listed = Command::new(program("worker"));
    listed.args(["variants", "--para", "hint", "--sources"]);
    let listed = listed.arg(&sources).output().expect("the worker runs");
    let listed = String::from_utf8_lossy(&listed.stdout);
    for words in ["act pragmatical", "Missing:", "git -C LIBERO-Para checkout dec2d93"] {
        assert!(listed.contains(words), "{listed}");
    }
}

#[tokio::test]
async fn a_campaign_of_sentences_has_the_outcomes_of_worker_rollout() {
    let test = "a_campaign_of_sentences_has_the_outcomes_of_worker_rollout";
    let Some(checkout) = para_checkout(test) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let (data, sources) = (folder.path().join("data"), folder.path().join("sources"));
    sources_without(Benchmark::Para, &sources);
    let from = ["libero-para", "--checkout", checkout.to_str().expect("UTF-8")];
    let fetched = fetch(&sources, &from);
    let errors = String::from_utf8_lossy(&fetched.stderr);
    assert!(fetched.status.success(), "{errors}");
    let campaigns = Campaigns::start(&data);
    let types = "act_pragmatical_hint_eval3_ver1,obj_lexical_same_polarity_contextual_eval3_ver2";
    let endpoint = campaigns.gateway.url.as_str();
    #[rustfmt::skip]
    let created = campaigns.succeed(&[
        "campaign", "create", "--name", "para", "--policy", "student", "--endpoint", endpoint,
        "--suite", "libero-para", "--paraphrase", types, "--tasks", "libero_goal",
    ]);
    assert!(created.contains("3 rollouts"), "{created}");
    let mut worker = Command::new(program("worker"));
    worker.args(["--connect", &campaigns.coordinator.url, "--slots", "1"]);
    worker.args(["--assets", "primitives", "--sources"]).arg(&sources);
    let _worker = Process::start(&mut worker);
    campaigns.wait_for_commits("para", None);
    let outcomes = stored(&data, "para").await;
    let prompts = outcomes.iter().map(|(id, outcome)| (id.as_str(), outcome.prompt.as_str()));
    let metadata = checkout.join("metrics/libero_para_metadata.csv");
    let metadata = std::fs::read_to_string(metadata).expect("the metadata");
    let sentence = |start: &str| {
        let line = metadata.lines().find(|line| line.starts_with(start));
        line.and_then(|line| line.split(',').nth(5)).expect("a sentence")
    };
    // The sentence of the type `hint` has a capital letter, which the prompt keeps.
    let expected = [
        ("goal/t8/para:act_hint_1/i00", sentence("act,pragmatical,hint,3,1,")),
        (
            "goal/t8/para:obj_contextual_2/i00",
            sentence("obj,lexical,same_polarity_contextual,3,2,"),
        ),
        ("goal/t8/para:unperturbed/i00", "put the bowl on the plate"),
    ];
    assert!(prompts.eq(expected), "{outcomes:?}");
    // The pictures and states do not depend on the sentence.
    let digests: BTreeSet<&[String; 3]> =
        outcomes.values().map(|outcome| &outcome.digests).collect();
    assert_eq!(digests.len(), 1, "{outcomes:?}");
    assert_same_alone(&campaigns, &outcomes, &["--sources", sources.to_str().expect("UTF-8")]);
    let report = campaigns.succeed(&["report", "para"]);
    for words in ["para-official", "obj lexical", "act pragmatical", "PRIDE", "α 0.5"] {
        assert!(report.contains(words), "{report}");
    }
}
