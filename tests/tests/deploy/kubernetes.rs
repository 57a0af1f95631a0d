//! Kubernetes manifests.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::{GIVE_BACK_SECS, folder, runs, unknown_flags};

/// Files of the folder `base` with resources; its other files are instructions to kustomize.
const BASE: [&str; 5] = ["namespace", "coordinator", "gateway", "workers", "network"];

/// Folders that can be applied to a cluster.
const FOLDERS: [&str; 2] = ["base", "job"];

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
    let base = BASE.iter().map(|name| folder("kubernetes/base").join(format!("{name}.yaml")));
    base.chain([secrets()]).collect()
}

fn secrets() -> PathBuf {
    folder("kubernetes").join("secrets.example.yaml")
}

/// The result of checking manifests that belong together.
#[derive(Debug, serde::Deserialize)]
struct Checked {
    faults: Vec<String>,
    commands: Vec<Vec<String>>,
    resources: usize,
}

fn check(python: &Path, groups: &[Vec<PathBuf>]) -> Vec<Checked> {
    let mut script = Command::new(python);
    script.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/deploy/manifests.py"));
    for files in groups {
        script.args(files).arg("--");
    }
    let output = script.output().expect("Python runs");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    let lines = serde_json::Deserializer::from_slice(&output.stdout).into_iter();
    let checked: Vec<Checked> = lines.map(|group| group.expect("a result")).collect();
    assert_eq!(checked.len(), groups.len());
    checked
}

fn assert_valid(checked: &Checked) {
    assert_eq!(checked.faults, [""; 0]);
    // Coordinator, gateway and worker.
    assert_eq!(checked.commands.len(), 3, "{checked:?}");
    for words in &checked.commands {
        assert_eq!(unknown_flags(words), [""; 0], "{words:?}");
    }
    assert!(checked.resources > 10, "{checked:?}");
}

#[test]
fn workers_have_given_back_their_rollouts_before_they_are_killed() {
    for name in ["base/workers.yaml", "job/workers.yaml"] {
        let text = fs::read_to_string(folder("kubernetes").join(name)).expect("a manifest");
        let number = |prefix: &str| -> u32 {
            let value = text.lines().find_map(|line| line.trim().strip_prefix(prefix));
            value.expect(prefix).trim().parse().expect("seconds")
        };
        let drain = number("- --drain-secs=");
        let grace = number("terminationGracePeriodSeconds:");
        assert!(drain + GIVE_BACK_SECS <= grace, "{name}: {drain} s of {grace} s");
    }
}

#[test]
fn manifests_are_valid_and_their_references_exist() {
    let Some(python) = python("manifests_are_valid_and_their_references_exist") else {
        return;
    };
    let checked = check(&python, &[base()]);
    assert_valid(&checked[0]);
}

#[test]
fn manifest_faults_are_named() {
    let Some(python) = python("manifest_faults_are_named") else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    // `workers.yaml` is the fourth of `BASE`.
    let text = fs::read_to_string(&base()[3]).expect("a manifest");
    let faults = [
        ("  replicas: 2", "  replica: 2", "replica"),
        ("secretName: rollout-worker", "secretName: worker", "no secret worker"),
        ("https://coordinator:7411", "https://coordinator:7412", "coordinator:7412"),
        ("runAsNonRoot: true", "runAsNonRoot: false", "may run as root"),
        ("/etc/rollout/token", "/etc/rollout/tokens", "no secret has tokens"),
    ];
    let groups = faults.iter().enumerate().map(|(index, (from, to, _))| {
        assert!(text.contains(from), "{from}");
        let broken = folder.path().join(format!("workers{index}.yaml"));
        fs::write(&broken, text.replace(from, to)).expect("a manifest");
        let mut files = base();
        files[3] = broken;
        files
    });
    let groups: Vec<_> = groups.collect();
    for (checked, (_, to, named)) in check(&python, &groups).iter().zip(faults) {
        let is_named = checked.faults.iter().any(|fault| fault.contains(named));
        assert!(is_named, "{to}: {:?}", checked.faults);
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
    let groups = FOLDERS.map(|name| {
        let mut kustomize = Command::new("kubectl");
        let output = kustomize.arg("kustomize").arg(folder("kubernetes").join(name));
        let output = output.output().expect("kubectl runs");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{name}: {errors}");
        let file = rendered.path().join(format!("{name}.yaml"));
        fs::write(&file, output.stdout).expect("manifests");
        vec![file, secrets()]
    });
    for (checked, name) in check(&python, &groups).iter().zip(FOLDERS) {
        println!("{name}");
        assert_valid(checked);
    }
}
