//! Crates that the programs link.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Deserialize;

use crate::cargo::cargo;
use crate::process::capture;

use super::release::PROGRAMS;

/// Crate whose code is part of a program.
pub(super) struct Crate {
    pub(super) name: String,
    pub(super) version: String,
    /// SPDX expression; empty if the crate declares no licence.
    pub(super) licence: String,
    pub(super) authors: Vec<String>,
    /// Folder with the crate's files.
    pub(super) folder: PathBuf,
    /// SHA-256 of the crate's archive.
    pub(super) checksum: Option<String>,
}

#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Package>,
    resolve: Resolve,
}

#[derive(Deserialize)]
struct Package {
    id: String,
    name: String,
    version: String,
    license: Option<String>,
    authors: Vec<String>,
    source: Option<String>,
    manifest_path: PathBuf,
    targets: Vec<Target>,
}

#[derive(Deserialize)]
struct Target {
    kind: Vec<String>,
}

#[derive(Deserialize)]
struct Resolve {
    nodes: Vec<Node>,
}

#[derive(Deserialize)]
struct Node {
    id: String,
    deps: Vec<Dependency>,
}

#[derive(Deserialize)]
struct Dependency {
    pkg: String,
    dep_kinds: Vec<Kind>,
}

#[derive(Deserialize)]
struct Kind {
    /// Kind of the dependency; `None` for a normal dependency.
    kind: Option<String>,
}

/// Returns all third-party crates that the programs link, sorted by name. Leaves out build-time
/// code: build scripts, macros and their dependencies.
pub(super) fn shipped(root: &Path) -> Result<Vec<Crate>> {
    let platform = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    let text = capture(cargo(root).args([
        "metadata",
        "--format-version",
        "1",
        "--offline",
        "--locked",
        "--filter-platform",
        &platform,
    ]))?;
    let metadata: Metadata = serde_json::from_str(&text).context("read cargo's metadata")?;
    let lock = root.join("Cargo.lock");
    let lock = std::fs::read_to_string(&lock).with_context(|| lock.display().to_string())?;
    let checksums = checksums(&lock);
    let linked = linked_packages(&metadata);
    let packages = metadata.packages.into_iter();
    let third_party =
        packages.filter(|package| package.source.is_some() && linked.contains(&package.id));
    let mut crates: Vec<Crate> = third_party
        .map(|package| Crate {
            checksum: checksums
                .get(&(package.name.as_str(), package.version.as_str()))
                .map(|checksum| (*checksum).to_owned()),
            name: package.name,
            version: package.version,
            // Crates from before SPDX expressions separate licences by a slash.
            licence: package.license.unwrap_or_default().replace(" / ", "/").replace('/', " OR "),
            authors: package.authors,
            folder: package.manifest_path.with_file_name(""),
        })
        .collect();
    crates.sort_by(|a, b| (&a.name, &a.version).cmp(&(&b.name, &b.version)));
    Ok(crates)
}

/// Returns the ids of all packages that the programs link, including the programs' own packages.
fn linked_packages(metadata: &Metadata) -> BTreeSet<String> {
    let nodes: BTreeMap<_, _> =
        metadata.resolve.nodes.iter().map(|node| (&node.id, node)).collect();
    let packages: BTreeMap<_, _> =
        metadata.packages.iter().map(|package| (&package.id, package)).collect();
    let programs = metadata.packages.iter();
    let programs = programs.filter(|package| PROGRAMS.contains(&package.name.as_str()));
    let mut pending: Vec<&String> = programs.map(|package| &package.id).collect();
    let mut visited = BTreeSet::new();
    while let Some(id) = pending.pop() {
        let mut kinds = packages[id].targets.iter().flat_map(|target| &target.kind);
        if kinds.any(|kind| kind == "proc-macro") || !visited.insert(id.clone()) {
            continue;
        }
        let normal = nodes[id].deps.iter();
        let normal =
            normal.filter(|dependency| dependency.dep_kinds.iter().any(|kind| kind.kind.is_none()));
        pending.extend(normal.map(|dependency| &dependency.pkg));
    }
    visited
}

/// Reads the checksums from `Cargo.lock`, by name and version.
fn checksums(lock: &str) -> BTreeMap<(&str, &str), &str> {
    let packages = lock.split("[[package]]").skip(1);
    let packages = packages.filter_map(|package| {
        let field = |name: &str| {
            let mut lines = package.lines();
            lines.find_map(|line| line.strip_prefix(name)?.strip_prefix(" = \"")?.strip_suffix('"'))
        };
        Some(((field("name")?, field("version")?), field("checksum")?))
    });
    packages.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_programs_are_made_of_crates_with_checksums_and_licences() {
        let crates = shipped(&crate::root()).expect("cargo's metadata");
        let named = |name: &str| crates.iter().any(|part| part.name == name);
        assert!(named("tokio") && named("openh264-sys2") && named("libsqlite3-sys"));
        assert!(!named("serde_derive"), "a procedural macro");
        assert!(!named("cc"), "a build dependency");
        assert!(!named("proptest"), "a test dependency");
        assert!(!named("worker"), "a crate of this workspace");
        for part in &crates {
            assert_eq!(part.checksum.as_deref().map(str::len), Some(64), "{}", part.name);
            assert!(!part.licence.is_empty() && !part.licence.contains('/'), "{}", part.name);
        }
    }
}
