//! Manifest files: expansion, checking, comparison, and campaigns that run a file unchanged.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Output;

use proto::coordinator::operator_service_client::OperatorServiceClient;
use proto::coordinator::{AppendRowsRequest, AppendedRow};
use queue::{Created, invariants};
use serde_json::{Value, json};
use tonic::Status;

use crate::harness::{small_spec, value};
use crate::process::{Serve, coordinator, fail, plus_spec, succeed, text};

fn expand(folder: &Path, name: &str, more: &[&str]) -> PathBuf {
    let path = folder.join(name);
    let output = ["manifest", "--output", path.to_str().expect("UTF-8")];
    succeed(coordinator(&[&output, more].concat()));
    path
}

fn rows(path: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(path).expect("readable");
    let rows = text.lines().map(|line| serde_json::from_str(line).expect("JSON"));
    rows.collect()
}

fn write(path: &Path, rows: &[Value]) {
    let lines = rows.iter().map(|row| format!("{row}\n"));
    std::fs::write(path, lines.collect::<String>()).expect("written");
}

fn manifest(files: &[&Path]) -> Output {
    let mut arguments = vec!["manifest"];
    arguments.extend(files.iter().map(|file| file.to_str().expect("UTF-8")));
    coordinator(&arguments)
}

#[test]
fn the_whole_design_is_2_000_clean_and_8_400_perturbed_rows() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let split = |split| {
        let name = format!("{split}.jsonl");
        expand(folder.path(), &name, &["--version", "v0.1", "--split", split])
    };
    let (clean, eval, all) = (split("clean"), split("eval"), split("all"));
    let counts = [&clean, &eval, &all].map(|path| rows(path).len());
    assert_eq!(counts, [2_000, 8_400, 10_400]);

    let all = rows(&all);
    let ids: BTreeSet<&str> =
        all.iter().map(|row| row["rollout_id"].as_str().expect("text")).collect();
    assert_eq!(ids.len(), all.len());
    assert!(ids.contains("spatial/t0/clean/i07"));
    let row = |id: &str| all.iter().find(|row| row["rollout_id"] == id).expect(id);
    // These values are in the reference's own files.
    let camera = row("goal/t0/combination/L1/c01");
    assert_eq!(camera["init_id"], 6);
    assert_eq!(camera["perturb"]["camera"]["d_azimuth_deg"], -3.58936);
    let robot = row("goal/t2/combination/L3/c05");
    assert_eq!(robot["init_id"], 15);
    assert_eq!(robot["perturb"]["robot"]["eef_rz_deg"], 21.091923);
    assert_eq!(row("long/t5/language/L2/c08")["perturb"], json!({}));

    let printed = &succeed(manifest(&[&folder.path().join("all.jsonl")]));
    assert!(
        printed.ends_with("10400 rows, 2000 nominal and 8400 perturbed; design v0.1\n"),
        "{printed}"
    );
}

#[test]
fn the_nominal_rows_of_liberos_family_are_those_of_unperturbed_tasks() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("spec.json");
    let noise = "put_the_bowl_on_the_plate_view_0_0_100_0_0_initstate_0_noise_30";
    std::fs::write(&path, plus_spec(noise).to_string()).expect("written");
    let spec = ["--spec", path.to_str().expect("UTF-8"), "--split"];
    for (split, expected) in
        [("nominal", "goal/t8/plus:unperturbed/i00"), ("eval", "goal/t8/plus:noise_30/i00")]
    {
        let rows = rows(&expand(folder.path(), split, &[&spec[..], &[split]].concat()));
        assert_eq!(rows.len(), 1, "{split}");
        assert_eq!(rows[0]["rollout_id"], expected);
    }
}

#[test]
fn a_custom_design_is_expanded_from_its_specification() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut spec = small_spec("own");
    spec["levels"] = json!(["r2.5"]);
    spec["configs"] = json!([3, 12]);
    let path = folder.path().join("spec.json");
    std::fs::write(&path, spec.to_string()).expect("written");
    let path = path.to_str().expect("UTF-8");
    let output = coordinator(&["manifest", "--spec", path, "--split", "eval"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let ids: Vec<Value> = text(&output.stdout)
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).expect("JSON")["rollout_id"].take())
        .collect();
    assert_eq!(
        ids,
        [
            "object/t0/camera/r2.5/c03",
            "object/t0/sensor/r2.5/c03",
            "object/t0/combination/r2.5/c03",
            "object/t0/camera/r2.5/c12",
            "object/t0/sensor/r2.5/c12",
            "object/t0/combination/r2.5/c12",
        ]
    );
}

#[test]
fn every_error_of_a_manifest_is_named_with_its_line() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = expand(folder.path(), "v.jsonl", &["--version", "v0.1", "--split", "eval"]);
    let mut rows = rows(&path);
    rows.truncate(6);
    rows[1]["perturb"]["blur_sigma"] = json!(1.0);
    rows[2]["level"] = json!("L3");
    rows[3]["init_id"] = json!(50);
    rows[4]["rollout_id"] = rows[0]["rollout_id"].clone();
    rows[4]["axis"] = rows[0]["axis"].clone();
    rows[4]["perturb"] = rows[0]["perturb"].clone();
    rows[5]["colour"] = json!("red");
    write(&path, &rows);
    let stderr = &fail(manifest(&[&path]), 1);
    for words in [
        "v.jsonl: read manifest: 5 errors",
        "line 2: read row spatial/t0/lighting/L1/c00: read `perturb`",
        "there is no field `blur_sigma`",
        "line 3: read row spatial/t0/robot/L1/c00: `level` is L3, but the id says L1",
        "line 4: read row spatial/t0/sensor/L1/c00: `init_id` is 50, valid are 0 to 49",
        "line 5: spatial/t0/camera/L1/c00 is already in line 1",
        "line 6: there is no field `colour`",
    ] {
        assert!(stderr.contains(words), "no {words:?} in {stderr}");
    }
}

#[test]
fn differences_are_named_by_row_and_column() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let original =
        expand(folder.path(), "original.jsonl", &["--version", "v0.1", "--split", "clean"]);
    let copy = folder.path().join("copy.jsonl");
    let mut changed = rows(&original);
    changed.reverse();
    write(&copy, &changed);
    let output = manifest(&[&original, &copy]);
    assert!(output.status.success(), "the order of rows does not count");
    assert!(text(&output.stdout).ends_with("have the same 2000 rows\n"));

    changed[0]["language"] = json!("sing");
    let removed = changed.pop().expect("rows");
    write(&copy, &changed);
    let output = manifest(&[&original, &copy]);
    assert_eq!(output.status.code(), Some(1));
    let printed = text(&output.stdout);
    assert!(printed.contains(", \"sing\" in the second\n"), "{printed}");
    let removed = removed["rollout_id"].as_str().expect("text");
    assert!(printed.contains(&format!("{removed}: only in the first manifest\n")), "{printed}");
    assert!(text(&output.stderr).contains("differ in 2 places"));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_imported_manifest_is_run_unchanged() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let all = expand(folder.path(), "all.jsonl", &["--version", "v0.1"]);
    let mut rows = rows(&all);
    // The rows are a configuration's language row and its nominal row. The nominal row comes last,
    // and its id is spelled differently than in released manifests.
    rows.retain(|row| {
        let id = row["rollout_id"].as_str().expect("text");
        id == "goal/t7/language/L3/c02" || id.starts_with("goal/t7/clean/")
    });
    let paired =
        rows.iter().find(|row| row["axis"] == "language").expect("a row")["init_id"].clone();
    rows.retain(|row| row["init_id"] == paired);
    rows.sort_by_key(|row| row["axis"] == "clean");
    rows[0]["language"] = json!("kindle the stove");
    rows[0]["max_steps"] = json!(123);
    rows[1]["rollout_id"] = json!(format!("goal/t7/clean/L0/c{paired:02}"));
    let path = folder.path().join("imported.jsonl");
    write(&path, &rows);
    let path = path.to_str().expect("UTF-8");

    let data = folder.path().join("data");
    let serve = Serve::start(&data);
    let create = |more: &[&str]| {
        let create = ["campaign", "create", "--name", "imported", "--policy", "expert"];
        let endpoint = ["--endpoint", "http://127.0.0.1:50051", "--rows", path];
        serve.command(&[&create[..], &endpoint, more].concat())
    };
    let refused = create(&["--levels", "L1"]);
    assert_eq!(refused.status.code(), Some(2), "a flag that would be ignored");
    let created = create(&["--replicates", "2"]);
    assert_eq!(
        text(&created.stdout),
        "campaign imported created: 4 rollouts\n",
        "{}",
        text(&created.stderr)
    );

    let mut worker = serve.worker("a").await;
    let leases = worker.claim(4).await;
    let leased: Vec<(Value, u32)> = leases
        .iter()
        .map(|lease| {
            let row = serde_json::from_str(&lease.manifest_row).expect("a manifest row");
            (row, lease.replicate)
        })
        .collect();
    let instructions: Vec<(&str, u32)> = leased
        .iter()
        .map(|(row, replicate)| (row["language"].as_str().expect("text"), *replicate))
        .collect();
    assert_eq!(
        instructions,
        [
            ("turn on the stove", 0),
            ("kindle the stove", 0),
            ("turn on the stove", 1),
            ("kindle the stove", 1),
        ]
    );
    assert_eq!(leased[1].0["max_steps"], 123);
    // A replicate has the same row and another policy seed.
    assert_eq!(leased[0].0, leased[2].0);
    assert_eq!(leased[1].0, leased[3].0);
    let seeds: BTreeSet<u64> = leases.iter().map(|lease| lease.policy_seed).collect();
    assert_eq!(seeds.len(), 4);

    let report = serve.command(&["report", "imported", "--full"]);
    let report = text(&report.stdout);
    assert!(report.contains("design `rows-"), "{report}");
}

#[tokio::test(flavor = "multi_thread")]
async fn rows_are_added_to_a_campaign_once_and_as_they_are_or_not_at_all() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut all = rows(&expand(folder.path(), "all.jsonl", &["--version", "v0.1"]));
    all.retain(|row| row["rollout_id"].as_str().expect("text").starts_with("goal/t7/"));
    let path = folder.path().join("first.jsonl");
    write(&path, &all[..3]);
    let serve = Serve::start(&folder.path().join("data"));
    let create = |name: &str, source: &[&str]| {
        let create = ["campaign", "create", "--name", name, "--policy", "expert"];
        let endpoint = ["--endpoint", "http://127.0.0.1:50051"];
        succeed(serve.command(&[&create[..], &endpoint, source].concat()))
    };
    let manifest = ["--rows", path.to_str().expect("UTF-8")];
    create("rows", &[&manifest[..], &["--replicates", "2"]].concat());
    create("design", &["--tasks", "libero_goal/7", "--levels", "L1", "--configs", "0"]);
    create("final", &manifest);
    succeed(serve.command(&["campaign", "cancel", "final"]));
    let mut operator = OperatorServiceClient::connect(serve.url.clone()).await.expect("connects");
    let mut append = async |campaign: &str, rows: &[Value], replicates: &[u32]| {
        let row = |row: &Value| AppendedRow {
            manifest_row: row.to_string(),
            replicates: replicates.to_vec(),
        };
        let (campaign, rows) = (campaign.to_owned(), rows.iter().map(row).collect());
        let request = AppendRowsRequest { campaign, rows, spec: String::new() };
        let added: Result<Created, Status> = value(operator.append_rows(request).await);
        added.map(|added| (added.jobs_added, added.jobs_total))
    };
    let mut worker = serve.worker("w").await;
    while let Some(lease) = worker.claim(1).await.pop() {
        worker.commit(&lease, true).await;
    }

    // A client that was killed sends rows again.
    assert_eq!(append("rows", &all[1..5], &[]).await.expect("added"), (4, 10));
    assert_eq!(append("rows", &all[1..5], &[]).await.expect("ignored"), (0, 10));
    let again = create("rows", &[&manifest[..], &["--replicates", "2"]].concat());
    assert!(again.contains("exists already, with this specification"), "{again}");
    let status = text(&serve.command(&["campaign", "status", "rows"]).stdout).to_owned();
    assert!(status.contains("6/10") && !status.contains("finished"), "{status}");
    let version = |name: &str| {
        let report = serve.command(&["report", name, "--json"]);
        let report: Value = serde_json::from_slice(&report.stdout).expect("JSON");
        report["reports"][0]["origin"]["campaign"]["design"].clone()
    };
    write(&path, &all[..5]);
    create("again", &manifest);
    assert_eq!(version("rows"), version("again"), "the rows of both are the same");
    write(&path, &all[..6]);
    let extended =
        succeed(serve.command(&[&["campaign", "extend", "rows"][..], &manifest].concat()));
    assert_eq!(extended, "campaign rows extended by 2 rollouts: 12 rollouts\n");

    // A valid new row comes first: it must not be added if the second is refused.
    let altered = |index: usize, field: &str, value: Value| {
        let mut row = all[index].clone();
        row[field] = value;
        vec![all[7].clone(), row]
    };
    let valid = || vec![all[7].clone(), all[6].clone()];
    let noise = "put_the_bowl_on_the_plate_view_0_0_100_0_0_initstate_0_noise_30";
    let variant = plus_spec(noise)["rows"][1].clone();
    for (campaign, rows, replicates, words) in [
        ("rows", altered(4, "max_steps", json!(7)), &[][..], "has max_steps 7, but 300"),
        ("rows", altered(6, "init_id", json!(50)), &[], "row 2 of the added rows: read row goal"),
        ("rows", altered(6, "init_id", json!(2)), &[], "initial states differ"),
        ("rows", altered(3, "init_id", json!(2)), &[], "has init_id 2, but"),
        ("rows", valid(), &[1], "names `replicates`"),
        ("design", valid(), &[], "its rows are those of a design"),
        ("rows", vec![variant], &[], "no protocol, but protocol `plus-official` in line 1"),
        ("final", valid(), &[], "it is cancelled"),
        ("none", valid(), &[], "no such campaign"),
    ] {
        let error = append(campaign, &rows, replicates).await.expect_err(words);
        assert!(error.message().contains(words), "{words}: {}", error.message());
    }
    assert_eq!(append("rows", &[], &[]).await.expect("nothing"), (0, 12), "none was added");
    let violations = invariants::check(&folder.path().join("data")).await.expect("a database");
    assert_eq!(violations, []);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_larger_design_adds_the_rollouts_that_the_campaign_lacks() {
    let (folder, serve) = Serve::anew();
    let campaign = |command: &str, name: &str, flags: &[&str]| {
        let name = if command == "create" { &["--name", name][..] } else { &[name] };
        serve.command(&[&["campaign", command][..], name, flags].concat())
    };
    let policy = ["--policy", "expert", "--endpoint", "http://127.0.0.1:50051"];
    let create = |name: &str, design: &[&str]| {
        succeed(campaign("create", name, &[&policy[..], design].concat()))
    };
    create("first", &["--tasks", "libero_goal/7", "--configs", "0", "--axes", "camera,robot"]);
    let mut worker = serve.worker("w").await;
    while let Some(lease) = worker.claim(1).await.pop() {
        worker.commit(&lease, true).await;
    }
    let more = ["--configs", "0-2", "--tasks", "libero_goal/8", "--levels", "L1,L2"];
    let extended = succeed(campaign("extend", "first", &more));
    // Two tasks with three configurations of one nominal and twice three perturbed rollouts.
    assert_eq!(extended, "campaign first extended by 38 rollouts: 42 rollouts\n");
    let extended = succeed(campaign("extend", "first", &more));
    assert_eq!(extended, "campaign first extended by 0 rollouts: 42 rollouts\n");
    succeed(campaign("extend", "first", &["--replicates", "2"]));
    let larger = [
        "--tasks",
        "libero_goal/7-8",
        "--configs",
        "0-2",
        "--axes",
        "camera,robot",
        "--levels",
        "L1,L2",
        "--replicates",
        "2",
    ];
    let again = create("first", &larger);
    assert!(again.contains("exists already, with this specification: 84 rollouts"), "{again}");
    let mut measured = 0;
    while let Some(lease) = worker.claim(1).await.pop() {
        worker.commit(&lease, true).await;
        measured += 1;
    }
    assert_eq!(measured, 80, "nothing is measured twice");
    create("whole", &larger);
    while let Some(lease) = worker.claim(1).await.pop() {
        worker.commit(&lease, true).await;
    }
    let paired = |name: &str| {
        let report = serve.command(&["report", name, "--json"]);
        let report: Value = serde_json::from_slice(&report.stdout).expect("JSON");
        report["paired"].clone()
    };
    assert_eq!(paired("first"), paired("whole"));

    create(
        "drawn",
        &["--tasks", "libero_goal", "--axes", "camera,robot", "--stop", "I excludes 0"],
    );
    for (name, flags, words) in [
        ("first", &["--replicates", "1"][..], "lacks some of its rollouts"),
        ("first", &["--configs", "nine"], "read configuration `nine`"),
        ("first", &["--rows", "-"], "read manifest: 1 error"),
        ("first", &[], "required"),
        ("drawn", &["--replicates", "2"], "`stop`"),
        ("drawn", &["--levels", "L3"], "it may stop early"),
        ("other", &["--levels", "L3"], "no such campaign"),
    ] {
        let refused = campaign("extend", name, flags);
        assert!(!refused.status.success(), "{name} {flags:?}");
        assert!(text(&refused.stderr).contains(words), "{words}: {}", text(&refused.stderr));
    }
    let violations = invariants::check(folder.path()).await.expect("a database");
    assert_eq!(violations, []);
}
