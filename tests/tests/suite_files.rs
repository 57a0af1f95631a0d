//! Suite files through real processes: a user's own suite, LIBERO-90, and their campaigns.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use benchmark::{FileTask, SuiteFile, TaskRef};
use scene::{AssetPack, Sources, TaskFiles, compose};
use serde_json::{Value, json};
use tests::files::{folder_with_links, libero};
use tests::outcome::{alone, stored};
use tests::programs::{Campaigns, Process, program};

/// Prompt of `libero_goal/8`, on which the student was trained.
const PROMPT: &str = "put the bowl on the plate";

/// A folder of sources with a suite of two tasks, copies of LIBERO's under other names.
struct OwnSuite {
    folder: tempfile::TempDir,
}

impl OwnSuite {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let original = tests::files::sources();
        let sources = folder.path().join("sources");
        fs::create_dir(&sources).expect("a folder");
        for part in ["libero", "robosuite", "packs"] {
            let link = sources.join(part);
            std::os::unix::fs::symlink(original.dir().join(part), link).expect("a link");
        }
        let suite = Self { folder };
        let files = suite.sources().join("suites/kitchen");
        fs::create_dir_all(files.join("states")).expect("a folder");
        for (task, name) in [("libero_goal/8", "plate"), ("libero_goal/7", "stove")] {
            let task = TaskFiles::of_task(&original, task.parse().expect("a task"));
            fs::copy(task.bddl, files.join(format!("{name}.bddl"))).expect("copies");
            let states = files.join(format!("states/{name}.pruned_init"));
            fs::copy(task.init, states).expect("copies");
        }
        suite.write(&json!({
            "name": "kitchen", "start": "initial-state", "prompt": "bddl", "seed": 0, "waits": 10,
            "budget": 300, "trials": 1,
            "suites": [{"name": "tables", "bddl": "*.bddl", "states": "states/*.pruned_init",
                "tasks": [{"name": "plate", "prompt": PROMPT}, "stove"]}],
        }));
        suite
    }

    fn sources(&self) -> PathBuf {
        self.folder.path().join("sources")
    }

    fn file(&self) -> PathBuf {
        self.folder.path().join("kitchen.json")
    }

    fn write(&self, suite_file: &Value) {
        fs::write(self.file(), suite_file.to_string()).expect("writes");
    }

    fn read(&self) -> Value {
        let text = fs::read_to_string(self.file()).expect("a file");
        serde_json::from_str(&text).expect("JSON")
    }

    fn call(&self, more: &[&str]) -> Output {
        self.call_with("primitives".as_ref(), more)
    }

    fn call_with(&self, assets: &Path, more: &[&str]) -> Output {
        let mut command = Command::new(program("worker"));
        command.arg("variants").arg("--suite-file").arg(self.file());
        command.arg("--assets").arg(assets).arg("--sources").arg(self.sources());
        command.args(more).output().expect("the worker runs")
    }

    fn create(&self, campaigns: &Campaigns, name: &str, policy: &str, more: &[&str]) {
        let path = self.file();
        #[rustfmt::skip]
        let create = [
            "campaign", "create", "--name", name, "--policy", policy,
            "--endpoint", &campaigns.gateway.url,
            "--suite-file", path.to_str().expect("UTF-8"),
        ];
        campaigns.succeed(&[&create[..], more].concat());
    }

    /// Starts a worker with the suite's sources, and its log in a file.
    fn worker(&self, campaigns: &Campaigns, log: &Path) -> Process {
        let mut command = Command::new(program("worker"));
        command.args(["--connect", &campaigns.coordinator.url, "--slots", "1"]);
        command.args(["--assets", "primitives", "--sources"]);
        let log = fs::File::create(log).expect("a file");
        Process::start(command.arg(self.sources()).stderr(log))
    }
}

#[track_caller]
fn succeed(output: Output) -> String {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    String::from_utf8(output.stdout).expect("UTF-8")
}

#[track_caller]
fn assert_refused(output: &Output, expected: &[&str]) {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success(), "{errors}");
    for words in expected {
        assert!(errors.contains(words), "no `{words}`: {errors}");
    }
}

#[tokio::test]
async fn a_users_suite_runs_by_its_file_as_liberos_tasks_do() {
    let suite = OwnSuite::new();
    let text = serde_json::to_string_pretty(&suite.read()).expect("JSON");
    assert!(text.lines().count() <= 30, "{text}");
    let data = suite.folder.path().join("data");
    let campaigns = Campaigns::start(&data);
    suite.create(&campaigns, "own", "student", &["--trials", "1"]);
    let _worker = suite.worker(&campaigns, &suite.folder.path().join("log"));
    campaigns.wait_for_commits("own", None);
    let report = campaigns.succeed(&["report", "own"]);
    for words in ["tables", "kitchen@"] {
        assert!(report.contains(words), "no `{words}`: {report}");
    }
    let outcomes = stored(&data, "own").await;
    assert!(outcomes.keys().eq(["own/t0/own:tables/i00", "own/t1/own:tables/i00"]));
    // The unperturbed rollout of the task that `plate` copies, under the protocol `plus-official`,
    // whose rules the suite file repeats.
    let more = ["--assets", "primitives"];
    let outcome = &outcomes["own/t0/own:tables/i00"];
    let unperturbed = alone(&campaigns.gateway.url, "goal/t8/plus:unperturbed/i00", &more);
    assert_eq!(outcome, &unperturbed);
    let paths = [suite.file(), suite.sources()].map(|path| path.display().to_string());
    let more = [&more[..], &["--suite-file", &paths[0], "--sources", &paths[1]]].concat();
    assert_eq!(outcome, &alone(&campaigns.gateway.url, "own/t0/own:tables/i00", &more));

    // The file's camera, posture, corruption and second initial state reach the simulator: all
    // first frames differ.
    let mut file = suite.read();
    file["budget"] = 1.into();
    file["suites"][0]["tasks"] = json!([
        "plate",
        {"name": "plate", "view": [0, 0, 181, 0, 0]},
        {"name": "plate", "posture": [0.1, -0.16, 0.0, -2.44, 0.0, 2.22, 0.78]},
        {"name": "plate", "noise": 30},
    ]);
    suite.write(&file);
    suite.create(&campaigns, "changed", "student", &["--trials", "2"]);
    campaigns.wait_for_commits("changed", None);
    let changed = stored(&data, "changed").await;
    assert_eq!(changed.len(), 8);
    let frames = changed.values().map(|outcome| &outcome.digests[2]);
    assert_eq!(frames.collect::<BTreeSet<_>>().len(), 8);

    // The tasks take LIBERO-CTRL's axes as LIBERO's do, on top of their own conditions.
    file["trials"] = 2.into();
    suite.write(&file);
    let design = ["--axes", "camera,actuation", "--configs", "0-1"];
    suite.create(&campaigns, "perturbed", "student", &design);
    campaigns.wait_for_commits("perturbed", None);
    let perturbed = stored(&data, "perturbed").await;
    let first_frame = |id: &str| &perturbed[id].digests[2];
    for task in 0..4 {
        let id = format!("own/t{task}/camera/L2/c00");
        let outcome = &perturbed[&id];
        assert_eq!(outcome, &alone(&campaigns.gateway.url, &id, &more));
        // Only the camera shows in the first frame.
        assert_eq!(&outcome.digests[2], first_frame(&id.replace("camera", "simultaneous")));
        let unseen = first_frame(&id.replace("camera", "actuation"));
        let is_nominal = |id: &&String| id.contains(&format!("t{task}/nominal/"));
        let mut nominal = perturbed.keys().filter(is_nominal);
        assert!(nominal.any(|id| first_frame(id) == unseen) && unseen != &outcome.digests[2]);
    }
    let frames = (0..4).map(|task| first_frame(&format!("own/t{task}/camera/L2/c00")).as_str());
    assert_eq!(frames.collect::<BTreeSet<_>>().len(), 4);
    let report = campaigns.succeed(&["report", "perturbed"]);
    for words in ["simultaneous", "camera", "actuation"] {
        assert!(report.contains(words), "no `{words}`: {report}");
    }
    campaigns.succeed(&["explain", "perturbed", "--create"]);
    campaigns.succeed(&["interactions", "perturbed"]);
    let shown = campaigns.succeed(&["jobs", "perturbed", "own/t1/camera/L2/c00"]);
    assert!(shown.contains("plate.bddl"), "{shown}");
}

#[test]
fn missing_and_foreign_files_are_named_before_anything_starts() {
    let suite = OwnSuite::new();
    let file = suite.read();
    let states = suite.sources().join("suites/kitchen/states/stove.pruned_init");
    let moved = states.with_extension("away");
    fs::rename(&states, &moved).expect("moves");
    let counted = succeed(suite.call(&[]));
    for words in
        ["tables                                  2        1", "stove.pruned_init; put it there"]
    {
        assert!(counted.contains(words), "no `{words}`: {counted}");
    }
    fs::rename(&moved, &states).expect("moves back");

    let check = |suite_file: &Value, expected: &[&str]| {
        suite.write(suite_file);
        let counted = succeed(suite.call(&[]));
        for words in expected {
            assert!(counted.contains(words), "no `{words}`: {counted}");
        }
    };
    let mut digest = file.clone();
    digest["suites"][0]["tasks"][1] = json!({"name": "stove", "sha256": "0".repeat(64)});
    check(&digest, &["the suite file's version of ", "their SHA-256 is "]);
    let mut folder = file.clone();
    folder["folder"] = "suites/elsewhere".into();
    check(&folder, &["folder ", "correct its `folder`"]);
    let mut many = file.clone();
    many["trials"] = 50.into();
    check(&many, &["tables                                100      100"]);
    let unknown = suite.sources().join("suites/kitchen/stove.bddl");
    let text = fs::read_to_string(&unknown).expect("a file");
    fs::write(&unknown, text.replace("- flat_stove", "- steep_stove")).expect("writes");
    check(&file, &["a scene that can be composed", "`steep_stove`"]);
    fs::write(&unknown, "(define").expect("writes");
    check(&file, &["stove.bddl"]);

    suite.write(&json!({"name": "kitchen"}));
    assert_refused(&suite.call(&[]), &["kitchen.json", "`start`", "docs/FAMILY.md"]);
    assert_refused(&suite.call(&["--pro", "libero_goal_swap"]), &["cannot be used with"]);
}

#[test]
fn a_folder_of_liberos_assets_may_hold_a_model_that_libero_lacks() {
    let test = "a_folder_of_liberos_assets_may_hold_a_model_that_libero_lacks";
    let Some(pack) = libero(&tests::files::sources(), test) else {
        return;
    };
    let suite = OwnSuite::new();
    let mut file = suite.read();
    file["budget"] = 1.into();
    suite.write(&file);
    let bddl = suite.sources().join("suites/kitchen/plate.bddl");
    let text = fs::read_to_string(&bddl).expect("a file");
    fs::write(&bddl, text.replace("- akita_black_bowl", "- black_bowl")).expect("writes");
    let assets = folder_with_links(pack.dir(), &["stable_scanned_objects"]);
    let count = |[all, runnable]: [u8; 2]| {
        let counted = succeed(suite.call_with(assets.path(), &[]));
        let line = format!("{:<32}{all:>9}{runnable:>9}\n", "tables");
        assert!(counted.contains(&line), "{counted}");
    };
    count([2, 1]);
    let models = assets.path().join("stable_scanned_objects");
    fs::create_dir(models.join("black_bowl")).expect("a folder");
    for name in ["akita_black_bowl.xml", "texture.png", "visual"] {
        let link = models.join("black_bowl").join(name.trim_start_matches("akita_"));
        let file = models.join("akita_black_bowl").join(name);
        std::os::unix::fs::symlink(file, link).expect("a link");
    }
    count([2, 2]);
    let campaigns = Campaigns::start(&suite.folder.path().join("data"));
    let paths = [&suite.file(), &suite.sources(), assets.path()];
    let [file, sources, assets] = paths.map(|path| path.to_str().expect("UTF-8"));
    let more = ["--suite-file", file, "--sources", sources, "--assets", assets];
    assert_eq!(alone(&campaigns.gateway.url, "own/t0/own:tables/i00", &more).steps, 1);
}

/// Returns the shipped LIBERO-90, cut down to the first ten tasks whose objects the built-in pack
/// has, one trial each and two steps.
fn ten_of_libero_90() -> SuiteFile {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/suites/libero_90.json");
    let text = fs::read_to_string(path).expect("the shipped file");
    assert!(text.lines().count() <= 100);
    let mut file = SuiteFile::from_json(&text).expect("a suite file");
    let suite = &mut file.suites[0];
    assert_eq!(suite.tasks.len(), 90);
    let sources = tests::files::sources();
    let pack = tests::files::primitives(&sources);
    suite.tasks.retain(|task| composes(task, &pack, &sources));
    suite.tasks.truncate(10);
    assert_eq!(suite.tasks.len(), 10);
    file.trials = 1;
    file.budget = 2;
    file
}

fn composes(task: &FileTask, pack: &AssetPack, sources: &Sources) -> bool {
    let files = TaskFiles {
        bddl: sources.bddl_file("libero_90", &task.name),
        init: sources.init_file("libero_90", &task.name),
    };
    let problem = files.problem().expect("a BDDL file");
    compose(&problem, pack, sources, 0).is_ok()
}

#[tokio::test]
async fn a_campaign_of_ten_tasks_of_libero_90_has_their_prompts_and_states() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let campaigns = Campaigns::start(&data);
    let path = folder.path().join("ten.json");
    let file = ten_of_libero_90();
    fs::write(&path, serde_json::to_string(&file).expect("JSON")).expect("writes");
    let file_text = path.to_str().expect("UTF-8");
    let url = campaigns.gateway.url.as_str();
    #[rustfmt::skip]
    let create = [
        "campaign", "create", "--name", "ninety", "--policy", "noop", "--endpoint", url,
        "--suite-file", file_text, "--record", "all",
    ];
    let created = campaigns.succeed(&create);
    assert!(created.contains("10 rollouts"), "{created}");
    let _worker = Process::worker(&campaigns.coordinator.url, 2, "primitives");
    campaigns.wait_for_commits("ninety", None);

    let outcomes = stored(&data, "ninety").await;
    for row in file.rows() {
        let outcome = &outcomes[&row.id.to_string()];
        assert_eq!((&outcome.prompt, outcome.steps), (&row.instruction, 2), "{}", row.id);
    }
    let states: BTreeSet<_> = outcomes.values().map(|outcome| &outcome.digests[1]).collect();
    assert_eq!((outcomes.len(), states.len()), (10, 10), "{outcomes:?}");

    let report = campaigns.succeed(&["report", "ninety"]);
    let protocol = file.protocol();
    assert!(report.contains(&format!("Suite file {protocol}\n")), "{report}");
    for words in ["libero_90  ", "all  "] {
        assert!(report.contains(words), "no `{words}`: {report}");
    }
    assert!(!report.contains("unperturbed"), "{report}");
    let json = campaigns.succeed(&["report", "ninety", "--json"]);
    let json: Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(json["family"]["groups"][0]["name"], "libero_90");
    assert_eq!(json["family"]["all"]["rollouts"], 10);
    assert_eq!(json["family"]["all"]["tasks"], 10);
    let export = campaigns.succeed(&["export", "ninety", "--format", "jsonl"]);
    let row: Value = serde_json::from_str(export.lines().next().expect("a row")).expect("JSON");
    assert_eq!(row["protocol"], protocol);
    assert_eq!((&row["suite"], &row["axis"]), (&json!("own"), &json!("variant")));
    let shown = campaigns.succeed(&["jobs", "ninety", "own/t0/own:libero_90/i00"]);
    assert!(shown.contains("close the top drawer of the cabinet"), "{shown}");

    // Another coordinator imports the archive with its films.
    let films = data.join("artifacts/ninety");
    let count = || fs::read_dir(&films).map_or(0, Iterator::count);
    let start = Instant::now();
    while count() < 10 {
        assert!(start.elapsed() < Duration::from_secs(120), "{} films", count());
        std::thread::sleep(Duration::from_millis(200));
    }
    let archive = folder.path().join("ninety.tar");
    let archive = archive.to_str().expect("UTF-8");
    campaigns.succeed(&["campaign", "archive", "ninety", "--output", archive]);
    let importer = Campaigns::start(&folder.path().join("importer"));
    importer.succeed(&["campaign", "import", archive]);
    assert_eq!(importer.outcomes("ninety"), campaigns.outcomes("ninety"));

    for arguments in [
        &["explain", "ninety", "--create"][..],
        &["report", "ninety", "ninety"],
        &["report", "ninety", "--table", "table.csv"],
    ] {
        let output = campaigns.call(arguments);
        assert!(!output.status.success(), "{arguments:?}");
    }
    for conflicting in [["--protocol", "pro-bddl"], ["--levels", "L1"]] {
        assert!(!campaigns.call(&[&create[..], &conflicting].concat()).status.success());
    }
    fs::write(&path, "{}").expect("writes");
    assert_refused(&campaigns.call(&create), &["ten.json", "`name`", "docs/FAMILY.md"]);
}

#[test]
fn a_worker_that_lacks_a_tasks_file_runs_other_tasks_until_the_file_exists() {
    let suite = OwnSuite::new();
    let mut file = suite.read();
    file["budget"] = 1.into();
    suite.write(&file);
    let campaigns = Campaigns::start(&suite.folder.path().join("data"));
    suite.create(&campaigns, "own", "noop", &["--trials", "3"]);
    let states = suite.sources().join("suites/kitchen/states/stove.pruned_init");
    let moved = states.with_extension("away");
    fs::rename(&states, &moved).expect("moves");
    let log = suite.folder.path().join("log");
    let _worker = suite.worker(&campaigns, &log);
    campaigns.wait_for_commits("own", Some(3));
    let start = Instant::now();
    let logged = |words: &str| fs::read_to_string(&log).expect("the log").contains(words);
    while !(logged("stove.pruned_init; put it there") && logged("own/1+kitchen@")) {
        let text = fs::read_to_string(&log).expect("the log");
        assert!(start.elapsed() < Duration::from_secs(120), "{text}");
        std::thread::sleep(Duration::from_millis(200));
    }
    // The worker leased at most one rollout of the task, whose failure told the coordinator that
    // the file is missing.
    std::thread::sleep(Duration::from_secs(3));
    let attempts = |trial: u8| {
        let id = format!("own/t1/own:tables/i{trial:02}");
        let shown = campaigns.succeed(&["jobs", "own", &id]);
        let line = shown.lines().find(|line| line.contains("attempts"));
        line.expect("a line").trim().to_owned()
    };
    let leased = (0..3).filter(|trial| !attempts(*trial).contains(" 0,")).count();
    assert!(leased <= 1, "{:?}", [0, 1, 2].map(attempts));
    fs::rename(&moved, &states).expect("moves back");
    campaigns.wait_for_commits("own", None);
    let outcomes = campaigns.outcomes("own");
    assert_eq!(outcomes.len(), 6, "{outcomes:?}");
}

#[test]
fn the_shipped_files_are_liberos_130_tasks() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/suites");
    let read = |name: &str| {
        let text = fs::read_to_string(folder.join(name)).expect("the shipped file");
        SuiteFile::from_json(&text).expect("a suite file")
    };
    let forty = read("libero_40.json");
    let names = forty.suites.iter().flat_map(|suite| &suite.tasks);
    let names: Vec<&str> = names.map(|task| task.name.as_str()).collect();
    assert_eq!(names, TaskRef::all().map(TaskRef::name).collect::<Vec<_>>());
    for (row, task) in forty.rows().iter().step_by(50).zip(TaskRef::all()) {
        assert_eq!(row.instruction, task.instruction());
        assert_eq!(row.max_steps, task.suite().max_steps());
    }
    assert_eq!(read("libero_pro_position.json").rows().len(), 99 * 50);
    let sources = tests::files::sources();
    for (name, count) in [("libero_90.json", 90 * 50), ("libero_40.json", 40 * 50)] {
        let mut command = Command::new(program("worker"));
        command.args(["variants", "--assets", "libero", "--sources"]);
        command.arg(sources.dir()).arg("--suite-file");
        let counted = command.arg(folder.join(name)).output();
        let counted = succeed(counted.expect("the worker runs"));
        let all = format!("{:<32}{count:>9}{count:>9}", "all");
        assert!(counted.contains(&all), "{name}: {counted}");
    }
}
