//! Checks that the archive is complete, and that its programs run with nothing but glibc.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::process::capture;
use crate::running::Running;
use crate::step::step;

use super::archive::{self, Archive};
use super::bare_root::{BareRoot, DATA, PREFIX};
use super::release::{PROGRAMS, VERSION};
use super::stage;

/// Options of a campaign of two rollouts that the expert solves: one nominal, one with a perturbed
/// camera.
const CAMPAIGN: [&str; 8] =
    ["--tasks", "libero_object/1", "--axes", "camera", "--levels", "L1", "--configs", "1"];

pub(crate) fn test(root: &Path, cache: &Path, programs: &Path) -> Result<()> {
    let output = tempfile::tempdir().context("make a folder")?;
    let packed = archive::make(root, cache, programs, output.path())?;
    check_archive(root, &packed)
}

pub(super) fn check_archive(root: &Path, archive: &Archive) -> Result<()> {
    println!("Testing {}", archive.file.display());
    let folder = tempfile::tempdir().context("make a folder")?;
    let bare = BareRoot::make(&folder.path().join("root"), archive)?;
    bare.add_data()?;
    let unpacked = bare.dir().join(PREFIX.trim_start_matches('/'));
    step("digests of all files", || verify_digests(&unpacked))?;
    step("documents", || check_documents(&unpacked))?;
    if let Some(problem) = bare.entry_problem() {
        println!("  skipped the programs in a bare root: {problem}");
        return Ok(());
    }
    step("versions in a bare root", || check_versions(root, &bare))?;
    step("a campaign in a bare root", || run_campaign(&bare, folder.path()))?;
    step("unpacked archive", || verify_digests(&unpacked).map(|_| "unchanged"))?;
    Ok(())
}

fn verify_digests(unpacked: &Path) -> Result<String> {
    let mut sums = Command::new("sha256sum");
    sums.current_dir(unpacked).args(["--check", "--strict", "--quiet", archive::SUMS]);
    capture(&mut sums)?;
    let listed = std::fs::read_to_string(unpacked.join(archive::SUMS))?.lines().count();
    let present = stage::files(unpacked)?.len();
    // The list of digests does not include itself.
    ensure!(
        present == listed + 1,
        "compare the archive with its list of digests: the list has {listed} files, and the \
         archive has {present} including the list"
    );
    Ok(format!("{listed} files"))
}

fn check_documents(unpacked: &Path) -> Result<&'static str> {
    for page in ["worker.1", "coordinator-campaign-create.1", "policy-gateway-check.1"] {
        let text = std::fs::read_to_string(unpacked.join("share/man/man1").join(page))?;
        ensure!(text.contains(".SH OPTIONS"), "read {page}: the manual page has no options");
    }
    for file in ["policies/pyproject.toml", "examples/openvla_oft/about.json"] {
        let path = unpacked.join(stage::FOR_USERS).join(file);
        ensure!(path.is_file(), "find {}: the archive lacks it", path.display());
    }
    Ok("complete")
}

/// Checks that every program prints the release and the commit; returns what they print.
fn check_versions(root: &Path, bare: &BareRoot) -> Result<String> {
    let mut git = Command::new("git");
    git.current_dir(root).args(["log", "-1", "--format=%h, %cs"]);
    let expected = match capture(&mut git) {
        Ok(commit) => format!("{VERSION} ({commit})"),
        Err(_) => VERSION.to_owned(),
    };
    for name in PROGRAMS {
        let version = capture(bare.program(name).arg("--version"))?;
        ensure!(
            version == format!("{name} {expected}"),
            "check that {name} has version {expected}: it prints {version:?}"
        );
    }
    Ok(expected)
}

fn run_campaign(bare: &BareRoot, logs: &Path) -> Result<String> {
    let start = |name: &str, arguments: &[&str]| {
        Running::start(name, bare.program(name).args(arguments), logs)
    };
    let data = format!("{DATA}/campaigns");
    let coordinator = start("coordinator", &["serve", "--data", &data, "--listen", "127.0.0.1:0"])?;
    let route = ["--route", "expert=builtin:expert"];
    let gateway = start("policy-gateway", &[&["--listen", "127.0.0.1:0"], &route[..]].concat())?;
    let connect = ["--connect", coordinator.url.as_str()];
    let _worker = start("worker", &[&connect[..], &["--assets", "primitives"]].concat())?;
    let call =
        |arguments: &[&str]| capture(bare.program("coordinator").args(arguments).args(connect));
    let policy = ["--policy", "expert", "--endpoint", &gateway.url];
    call(&[&["campaign", "create", "--name", "bare"], &policy[..], &CAMPAIGN].concat())?;
    call(&["campaign", "status", "bare", "--watch"])?;
    let results = call(&["export", "bare", "--format", "jsonl"])?;
    let successes = results.lines().filter(|row| row.contains("\"success\":true")).count();
    let rollouts = results.lines().count();
    ensure!(rollouts > 0 && successes == rollouts, "check that the expert succeeds:\n{results}");
    call(&["report", "bare"])?;
    Ok(format!("{successes} of {rollouts} rollouts successful"))
}
