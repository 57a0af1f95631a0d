//! Calling cargo, and finding what it built.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Result;

use crate::process::run;

/// Cargo in the workspace.
pub(crate) fn cargo(root: &Path) -> Command {
    let program = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut cargo = Command::new(program);
    cargo.current_dir(root);
    cargo
}

/// Builds all programs and returns the folder that they are in.
pub(crate) fn build_programs(root: &Path) -> Result<PathBuf> {
    println!("Building the programs");
    build(root, &["--bins"])
}

/// Builds these programs and returns the folder that they are in.
pub(crate) fn build_only(root: &Path, names: &[&str]) -> Result<PathBuf> {
    println!("Building {}", names.join(", "));
    let bins: Vec<&str> = names.iter().flat_map(|name| ["--bin", name]).collect();
    build(root, &bins)
}

/// Builds one program and returns its file. It is built as part of the workspace,
/// so that what it depends on is compiled for all programs once.
pub(crate) fn build_program(root: &Path, name: &str) -> Result<PathBuf> {
    let programs = build(root, &["--quiet", "--bin", name])?;
    Ok(programs.join(name))
}

/// The same as it would be handed out.
pub(crate) fn build_released_program(root: &Path, name: &str) -> Result<PathBuf> {
    let programs = build(root, &["--quiet", "--release", "--bin", name])?;
    Ok(programs.with_file_name("release").join(name))
}

/// Builds these programs as they are handed out, and returns the folder that they are in.
pub(crate) fn build_released_programs(root: &Path, names: &[&str]) -> Result<PathBuf> {
    println!("Building the programs as they are handed out");
    let bins = names.iter().flat_map(|name| ["--bin", name]);
    let what: Vec<&str> = std::iter::once("--release").chain(bins).collect();
    Ok(build(root, &what)?.with_file_name("release"))
}

fn build(root: &Path, what: &[&str]) -> Result<PathBuf> {
    run(cargo(root)
        .args(["build", "--workspace", "--exclude", "xtask"])
        .args(what))?;
    // This program was built by the same cargo into the same folder.
    let own = std::env::current_exe()?;
    Ok(own
        .parent()
        .map_or_else(|| root.join("target/debug"), Path::to_owned))
}
