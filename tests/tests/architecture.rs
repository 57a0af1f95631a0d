//! Allowed dependencies between crates, read from the diagram in docs/dev/ARCHITECTURE.md.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

fn cargo(arguments: &[&str]) -> Vec<u8> {
    let output = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .args(arguments)
        .arg("--offline")
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

fn metadata(arguments: &[&str]) -> Value {
    let metadata = [&["metadata", "--format-version", "1"], arguments].concat();
    serde_json::from_slice(&cargo(&metadata)).unwrap()
}

/// Dependencies of the packages that the cargo arguments `packages` select, each with the features
/// that these packages enable.
fn features(packages: &[&str], edges: &str) -> BTreeSet<String> {
    let tree = ["tree", "--prefix", "none", "--no-dedupe", "--format", "{p} {f}", "--edges", edges];
    let text = String::from_utf8(cargo(&[&tree, packages].concat())).unwrap();
    text.lines().map(str::to_owned).collect()
}

/// A clean checkout compiles a dependency twice, with its dependents, if xtask, the programs, the
/// Python extension and the tests enable different features of it.
#[test]
fn one_build_of_each_dependency_serves_programs_and_tests() {
    let tests = features(&["--workspace"], "normal,build,dev");
    for packages in [
        &["--workspace", "--exclude", "xtask"][..],
        &["--package", "xtask"],
        &["--package", "python"],
    ] {
        let selected = features(packages, "normal,build");
        let twice: Vec<_> = selected.difference(&tests).collect();
        assert!(
            twice.is_empty(),
            "dependencies of {packages:?} have other features than in the tests: {twice:?}; add \
             the tests' features to the package `workspace-hack`"
        );
    }
}

/// Tools around the programs. They may use every crate, and no crate may use them.
const TOOLS: [&str; 2] = ["tests", "xtask"];

/// Libraries reserved for one responsibility, each with the crates that may use it.
const LIBRARIES: [(&str, &[&str]); 8] = [
    ("mujoco-rs", &["sim"]),
    ("sqlx", &["queue"]),
    ("pyo3", &["python"]),
    ("ureq", &["scene"]),
    ("maud", &["coordinator", "report"]),
    ("parquet", &["report"]),
    ("prost", &["proto", "policy-backends"]),
    (
        "tokio",
        &["coordinator", "policy-backends", "policy-gateway", "queue", "transport", "worker"],
    ),
];

/// Direct normal dependencies of every crate of the workspace, by name.
fn dependencies() -> BTreeMap<String, BTreeSet<String>> {
    let metadata = metadata(&["--no-deps"]);
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let packages = metadata["packages"].as_array().unwrap();
    let normal = |package: &Value| {
        let all = package["dependencies"].as_array().unwrap();
        let normal = all.iter().filter(|dependency| dependency["kind"].is_null());
        normal.map(|dependency| text(&dependency["name"])).collect()
    };
    let named = packages.iter().map(|package| (text(&package["name"]), normal(package)));
    named.collect()
}

/// Crates of each line of the diagram in docs/dev/ARCHITECTURE.md, from the top.
fn layers() -> Vec<Vec<String>> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/dev/ARCHITECTURE.md");
    let page = std::fs::read_to_string(path).unwrap();
    let rule = "A crate uses only crates on the lines below its own.";
    let (before, _) = page.split_once(rule).expect("the page states the rule");
    let diagram = before.rsplit("```").nth(1).expect("a diagram before the rule");
    let line = |line: &str| line.split_whitespace().map(str::to_owned).collect();
    diagram.trim().lines().map(line).collect()
}

fn violations(
    layers: &[Vec<String>],
    dependencies: &BTreeMap<String, BTreeSet<String>>,
) -> Vec<String> {
    let layer = |name: &str| {
        let holds = |layer: &Vec<String>| layer.iter().any(|member| member == name);
        layers.iter().position(holds)
    };
    let mut violations = Vec::new();
    for (name, used) in dependencies {
        if TOOLS.contains(&&**name) {
            continue;
        }
        let Some(user_layer) = layer(name) else {
            violations.push(format!("{name} is not in the diagram"));
            continue;
        };
        for dependency in used {
            let is_workspace_crate = dependencies.contains_key(dependency);
            let is_allowed = match (is_workspace_crate, layer(dependency)) {
                (true, Some(dependency_layer)) => dependency_layer > user_layer,
                (true, None) => false,
                (false, _) => LIBRARIES
                    .iter()
                    .all(|(library, crates)| library != dependency || crates.contains(&&**name)),
            };
            if !is_allowed {
                violations.push(format!("{name} uses {dependency}"));
            }
        }
    }
    violations
}

#[test]
fn crates_use_only_crates_on_lower_lines_of_the_diagram() {
    let (layers, dependencies) = (layers(), dependencies());
    let unknown = layers.iter().flatten();
    let unknown: Vec<_> = unknown.filter(|name| !dependencies.contains_key(*name)).collect();
    assert!(unknown.is_empty(), "not crates of the workspace: {unknown:?}");
    let violations = violations(&layers, &dependencies);
    assert!(violations.is_empty(), "{violations:#?}");
}

fn sources(folder: &Path, ending: &str) -> String {
    let mut text = String::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            text.push_str(&sources(&path, ending));
        } else if path.extension().is_some_and(|extension| extension == ending) {
            text.push_str(&std::fs::read_to_string(&path).unwrap());
        }
    }
    text
}

fn rust_sources() -> String {
    let mut code = String::new();
    for package in metadata(&["--no-deps"])["packages"].as_array().unwrap() {
        let manifest = PathBuf::from(package["manifest_path"].as_str().unwrap());
        for folder in ["src", "tests"] {
            code.push_str(&sources(&manifest.with_file_name(folder), "rs"));
        }
    }
    code
}

fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// Names in a page's prose: words between single backticks, without blanks.
fn names(page: &str) -> Vec<&str> {
    let outside = page.split("\n```").step_by(2);
    let quoted = outside.flat_map(|prose| prose.split('`').skip(1).step_by(2));
    quoted.filter(|word| !word.is_empty() && !word.contains(char::is_whitespace)).collect()
}

/// Returns true for a name in snake case of at least three words.
fn is_long_name(name: &str) -> bool {
    let is_name_character = |character: char| {
        character.is_ascii_lowercase() || character.is_ascii_digit() || character == '_'
    };
    name.chars().all(is_name_character) && name.matches('_').count() >= 2
}

/// Names on pages that occur only in the sources of other projects.
const FOREIGN: [&str; 1] = ["get_camera_meta"];

#[test]
fn pages_name_only_files_and_tests_that_exist() {
    let mut code = rust_sources();
    for folder in ["python", "policies", "training", "tests"] {
        code.push_str(&sources(&root().join(folder), "py"));
    }
    let is_word_character = |character: char| character.is_ascii_alphanumeric() || character == '_';
    let words: BTreeSet<&str> = code.split(|character| !is_word_character(character)).collect();
    let exists = |name: &str| match name.split_once('/') {
        Some((folder, _)) if !folder.is_empty() && root().join(folder).join("").is_dir() => {
            root().join(name).exists()
        }
        // Other paths are names of tasks, and files of users and other projects.
        Some(_) => true,
        None if !is_long_name(name.trim_end_matches('…')) => true,
        // The common beginning of several tests' names.
        None if name.ends_with('…') => code.contains(&format!(" {}", name.trim_end_matches('…'))),
        None => words.contains(name) || FOREIGN.contains(&name),
    };
    let mut missing = Vec::new();
    let folders = ["docs", "docs/dev"].map(|folder| std::fs::read_dir(root().join(folder)));
    for entry in folders.into_iter().flat_map(Result::unwrap) {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "md") {
            let page = std::fs::read_to_string(&path).unwrap();
            let names = names(&page).into_iter().filter(|name| !exists(name));
            missing.extend(names.map(|name| format!("{}: {name}", path.display())));
        }
    }
    assert!(missing.is_empty(), "not in the repository: {missing:#?}");
}
