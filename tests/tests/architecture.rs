//! Which crate may use which, and how the files of each do. The reasons are in
//! docs/ARCHITECTURE.md.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// What Cargo says of the workspace.
fn metadata(arguments: &[&str]) -> Value {
    let output = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .args(["metadata", "--format-version", "1", "--offline"])
        .args(arguments)
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Normal dependencies of every package, by name.
fn dependencies() -> BTreeMap<String, BTreeSet<String>> {
    // Crates for other systems have never been fetched here.
    let platform = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    let metadata = metadata(&["--filter-platform", &platform]);
    let list = |value: &Value| value.as_array().unwrap().clone();
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let names: BTreeMap<String, String> = list(&metadata["packages"])
        .iter()
        .map(|package| (text(&package["id"]), text(&package["name"])))
        .collect();
    let mut graph = BTreeMap::new();
    for node in list(&metadata["resolve"]["nodes"]) {
        let normal = list(&node["deps"])
            .iter()
            .filter(|dep| {
                list(&dep["dep_kinds"])
                    .iter()
                    .any(|kind| kind["kind"].is_null())
            })
            .map(|dep| names[&text(&dep["pkg"])].clone())
            .collect();
        graph.insert(names[&text(&node["id"])].clone(), normal);
    }
    graph
}

/// Everything that a package uses, directly or not.
fn reachable(graph: &BTreeMap<String, BTreeSet<String>>, from: &str) -> BTreeSet<String> {
    let mut seen = BTreeSet::new();
    let mut open = vec![from.to_owned()];
    while let Some(name) = open.pop() {
        for next in &graph[&name] {
            if seen.insert(next.clone()) {
                open.push(next.clone());
            }
        }
    }
    seen
}

#[test]
fn crates_use_one_another_in_the_agreed_directions_only() {
    let graph = dependencies();
    let forbidden = [
        (
            "protocol",
            &["scene", "sim", "paired", "proto", "tokio"][..],
        ),
        (
            "attempt",
            &["scene", "sim", "paired", "proto", "tokio", "sqlx", "maud"],
        ),
        (
            "assets",
            &[
                "scene",
                "sim",
                "proto",
                "transport",
                "terminal",
                "tokio",
                "clap",
            ],
        ),
        ("scene", &["sim", "proto", "tokio", "mujoco-rs"]),
        (
            "raster",
            &["protocol", "scene", "proto", "tokio", "mujoco-rs"],
        ),
        ("expert", &["scene", "sim", "proto", "tokio"]),
        ("student", &["protocol", "scene", "sim", "proto", "tokio"]),
        ("sim", &["proto", "tokio", "sqlx", "paired"]),
        (
            "queue",
            &[
                "scene",
                "sim",
                "report",
                "proto",
                "transport",
                "tonic",
                "maud",
            ],
        ),
        ("paired", &["scene", "sim", "proto", "tokio", "sqlx"]),
        ("lattice", &["scene", "sim", "proto", "tokio", "sqlx"]),
        (
            "thresholds",
            &["lattice", "scene", "sim", "proto", "tokio", "sqlx"],
        ),
        ("report", &["scene", "sim", "proto", "tokio", "sqlx"]),
        ("proto", &["protocol", "scene", "sim", "paired"]),
        (
            "transport",
            &["proto", "protocol", "scene", "sim", "paired", "sqlx"],
        ),
        ("coordinator", &["scene", "sim", "worker", "policy-gateway"]),
        (
            "worker",
            &["sqlx", "coordinator", "policy-gateway", "paired", "report"],
        ),
        (
            "policy-gateway",
            &["sqlx", "scene", "sim", "coordinator", "worker"],
        ),
        ("python", &["worker", "proto", "transport", "tokio", "sqlx"]),
        ("xtask", &["scene", "sim", "tokio"]),
    ];
    for (package, others) in forbidden {
        let used = reachable(&graph, package);
        for other in others {
            assert!(!used.contains(*other), "{package} must not use {other}");
        }
    }
}

/// All Rust sources below a folder, one after the other.
fn sources(folder: &Path) -> String {
    let mut text = String::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            text.push_str(&sources(&path));
        } else if path.extension().is_some_and(|it| it == "rs") {
            text.push_str(&std::fs::read_to_string(&path).unwrap());
        }
    }
    text
}

#[test]
fn the_map_names_only_files_tests_and_invariants_that_exist() {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let map = std::fs::read_to_string(root.join("docs/ARCHITECTURE.md")).unwrap();
    let mut code = String::new();
    for package in metadata(&["--no-deps"])["packages"].as_array().unwrap() {
        let manifest = PathBuf::from(package["manifest_path"].as_str().unwrap());
        for folder in ["src", "tests"] {
            code.push_str(&sources(&manifest.with_file_name(folder)));
        }
    }
    // Names in prose stand between single backticks and hold no blanks.
    let names = map.split('`').skip(1).step_by(2);
    let names = names.filter(|it| !it.is_empty() && !it.contains(char::is_whitespace));
    let is_there = |name: &str| {
        if name.contains('/') {
            root.join(name).exists()
        } else if name.matches('_').count() >= 2 {
            code.contains(&format!("fn {name}(")) || code.contains(&format!("\"{name}\""))
        } else {
            true
        }
    };
    let missing: Vec<&str> = names.filter(|it| !is_there(it)).collect();
    assert!(missing.is_empty(), "not in the repository: {missing:?}");
}

#[test]
fn no_files_of_a_crate_import_in_a_circle() {
    let metadata = metadata(&["--no-deps"]);
    let packages = metadata["packages"].as_array().unwrap();
    let mut found = String::new();
    for package in packages {
        let name = package["name"].as_str().unwrap();
        let manifest = PathBuf::from(package["manifest_path"].as_str().unwrap());
        for circle in tests::circles::circles(&manifest.with_file_name("src")).unwrap() {
            found.push_str(&format!("in {name}:\n{circle}"));
        }
    }
    assert!(found.is_empty(), "files that import in a circle:\n{found}");
}
