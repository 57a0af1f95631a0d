//! Kubernetes manifests.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::{GIVE_BACK_SECS, folder, runs, unknown_flags};

/// Files of the folder `base` with resources; its other files are instructions to kustomize.
const BASE: [&str; 5] = ["namespace", "coordinator", "gateway", "workers", "network"];

/// Folders that can be applied to a cluster.
const FOLDERS: [&str; 3] = ["base", "keda", "job"];

/// Returns an interpreter with `kubernetes-validate`; if there is none, prints that the test is
/// skipped.
fn python(test: &str) -> Option<PathBuf> {
    let python = std::env::var_os("ROLLOUT_DEPLOY_PYTHON").map(PathBuf::from);
    if python.is_none() {
        println!("skipped {test}: `cargo xtask test` installs kubernetes-validate if it can");
    }
    python
}

fn base() -> Vec<PathBuf> {
    let base = BASE
        .iter()
        .map(|name| folder("kubernetes/base").join(format!("{name}.yaml")));
    base.chain([secrets()]).collect()
}

fn secrets() -> PathBuf {
    folder("kubernetes").join("secrets.example.yaml")
}

/// Returns true if the manifests are valid, and the output of the check.
fn check(python: &Path, files: &[PathBuf]) -> (bool, String) {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/deploy/manifests.py");
    let output = Command::new(python)
        .arg(script)
        .args(files)
        .output()
        .expect("Python runs");
    let decode = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let text = decode(&output.stdout) + &decode(&output.stderr);
    (output.status.success(), text)
}

/// Asserts that manifests and their command lines are valid; returns the kinds without a schema.
fn assert_valid(python: &Path, files: &[PathBuf]) -> serde_json::Value {
    let (is_valid, output) = check(python, files);
    assert!(is_valid, "{output}");
    let (commands, last) = output.trim_end().rsplit_once('\n').expect("some lines");
    // The command lines of coordinator, gateway and worker.
    assert_eq!(commands.lines().count(), 3, "{commands}");
    for line in commands.lines() {
        let words: Vec<String> = serde_json::from_str(line).expect("a command line");
        assert_eq!(unknown_flags(&words), [""; 0], "{line}");
    }
    let summary: serde_json::Value = serde_json::from_str(last).expect("a summary");
    assert!(
        summary["checked"].as_u64().expect("a number") > 10,
        "{summary}"
    );
    summary["no schema"].clone()
}

#[test]
fn workers_have_given_back_their_rollouts_before_they_are_killed() {
    for name in ["base/workers.yaml", "job/workers.yaml"] {
        let text = fs::read_to_string(folder("kubernetes").join(name)).expect("a manifest");
        let number = |prefix: &str| -> u32 {
            let value = text
                .lines()
                .find_map(|line| line.trim().strip_prefix(prefix));
            value.expect(prefix).trim().parse().expect("seconds")
        };
        let drain = number("- --drain-secs=");
        let grace = number("terminationGracePeriodSeconds:");
        assert!(
            drain + GIVE_BACK_SECS <= grace,
            "{name}: {drain} s of {grace} s"
        );
    }
}

#[test]
fn manifests_are_valid_and_their_references_exist() {
    let Some(python) = python("manifests_are_valid_and_their_references_exist") else {
        return;
    };
    assert_eq!(assert_valid(&python, &base()), serde_json::json!([]));
}

#[test]
fn manifest_faults_are_named() {
    let Some(python) = python("manifest_faults_are_named") else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let broken = folder.path().join("workers.yaml");
    let mut files = base();
    // `workers.yaml` is the fourth of `BASE`.
    let text = fs::read_to_string(&files[3]).expect("a manifest");
    files[3] = broken.clone();
    for (from, to, named) in [
        ("  replicas: 2", "  replica: 2", "replica"),
        (
            "secretName: rollout-worker",
            "secretName: worker",
            "no secret worker",
        ),
        (
            "https://coordinator:7411",
            "https://coordinator:7412",
            "coordinator:7412",
        ),
        (
            "runAsNonRoot: true",
            "runAsNonRoot: false",
            "may run as root",
        ),
        (
            "/etc/rollout/token",
            "/etc/rollout/tokens",
            "no secret has tokens",
        ),
    ] {
        assert!(text.contains(from), "{from}");
        fs::write(&broken, text.replace(from, to)).expect("a manifest");
        let (is_valid, output) = check(&python, &files);
        assert!(!is_valid && output.contains(named), "{to}: {output}");
    }
}

#[test]
fn kustomize_renders_valid_manifests_of_every_folder() {
    let test = "kustomize_renders_valid_manifests_of_every_folder";
    let Some(python) = python(test) else { return };
    if !runs("kubectl", "version") {
        println!("skipped {test}: no kubectl");
        return;
    }
    let rendered = tempfile::tempdir().expect("a folder");
    for name in FOLDERS {
        let mut kustomize = Command::new("kubectl");
        let output = kustomize
            .arg("kustomize")
            .arg(folder("kubernetes").join(name));
        let output = output.output().expect("kubectl runs");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{name}: {errors}");
        let file = rendered.path().join(format!("{name}.yaml"));
        fs::write(&file, output.stdout).expect("manifests");
        let foreign = assert_valid(&python, &[file, secrets()]);
        let expected = if name == "keda" {
            &["ScaledObject"][..]
        } else {
            &[]
        };
        assert_eq!(foreign, serde_json::json!(expected), "{name}");
    }
}
