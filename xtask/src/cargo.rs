//! Calls cargo and locates the programs that it built.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::run;

/// Glibc that a release is linked against: the oldest one that runs it, that of RHEL 8 and Debian 10.
pub(crate) const GLIBC: (u32, u32) = (2, 28);

/// Returns the command of the cargo that runs this program, in the workspace's folder.
pub(crate) fn cargo(root: &Path) -> Command {
    let program = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut cargo = Command::new(program);
    cargo.current_dir(root);
    remove_package_variables(&mut cargo);
    cargo
}

/// Removes the environment variables with which `cargo run` describes xtask's package. ring's build
/// script reads them: ring and every crate that uses it would be compiled again whenever one build
/// has these variables and the next has not.
pub(crate) fn remove_package_variables(command: &mut Command) {
    for (name, _) in std::env::vars_os() {
        let text = name.to_string_lossy();
        if text.starts_with("CARGO_PKG_") || text.starts_with("CARGO_MANIFEST_") {
            command.env_remove(&name);
        }
    }
}

/// Arguments that select the features of the whole workspace, so that dependencies are compiled
/// only once for all programs.
const WORKSPACE: [&str; 3] = ["--workspace", "--exclude", "xtask"];

pub(crate) fn build_programs(root: &Path) -> Result<PathBuf> {
    println!("Building the programs");
    build(root, &[&WORKSPACE[..], &["--bins"]].concat())
}

/// Builds the packages of the named programs without optional features, and returns their folder.
pub(crate) fn build_only(root: &Path, names: &[&str]) -> Result<PathBuf> {
    println!("Building {}", names.join(", "));
    // With the workspace, other packages' dependencies would enable the features after all;
    // `workspace-hack` selects the features with which xtask's dependencies are compiled.
    let packages = names.iter().chain(&["workspace-hack"]);
    let packages: Vec<&str> = packages.flat_map(|name| ["--package", name]).collect();
    build(root, &[&["--no-default-features", "--bins"], &packages[..]].concat())
}

pub(crate) fn build_program(root: &Path, name: &str) -> Result<PathBuf> {
    let programs = build(root, &[&WORKSPACE[..], &["--quiet", "--bin", name]].concat())?;
    Ok(programs.join(name))
}

/// Builds the named programs with the release profile for [`GLIBC`], and returns their folder.
/// `tools` has zig, which links against any version of glibc and brings its own runtime.
pub(crate) fn build_released_programs(
    root: &Path,
    tools: &Path,
    names: &[&str],
) -> Result<PathBuf> {
    println!("Building the programs with the release profile");
    let target = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    let mut zigbuild = Command::new(tools.join("cargo-zigbuild"));
    zigbuild.current_dir(root).env("PATH", path_with(tools)?);
    remove_package_variables(&mut zigbuild);
    zigbuild.args(["zigbuild", "--release", "--target"]);
    zigbuild.arg(format!("{target}.{}.{}", GLIBC.0, GLIBC.1)).args(WORKSPACE);
    run(zigbuild.args(names.iter().flat_map(|name| ["--bin", name])))?;
    Ok(build_folder(root)?.with_file_name(target).join("release"))
}

pub(crate) fn path_with(folder: &Path) -> Result<OsString> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let path = std::iter::once(folder.to_owned()).chain(std::env::split_paths(&path));
    std::env::join_paths(path).context("join PATH")
}

fn build(root: &Path, arguments: &[&str]) -> Result<PathBuf> {
    run(cargo(root).arg("build").args(arguments))?;
    build_folder(root)
}

fn build_folder(root: &Path) -> Result<PathBuf> {
    // The same cargo built this program into the same folder.
    let this_program = std::env::current_exe()?;
    Ok(this_program.parent().map_or_else(|| root.join("target/debug"), Path::to_owned))
}
