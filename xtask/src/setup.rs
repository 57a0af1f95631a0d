//! Checks and fetches the requirements of a build of the workspace, and installs optional parts:
//! OpenGL rendering, a browser for the live page, a cluster scheduler for tests.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::cargo::build_programs;
use crate::packages::{WHEELS, Wheel};
use crate::process::{capture, run as run_command};
use crate::step::step;

/// Debian packages for off-screen OpenGL rendering, and the libraries whose presence shows that the
/// packages are installed.
const GL_PACKAGES: [&str; 5] =
    ["libegl1", "libegl-mesa0", "libgl1-mesa-dri", "libgl1", "libopengl0"];
const GL_LIBRARIES: [&str; 3] = ["libEGL.so.1", "libGL.so.1", "libOpenGL.so.0"];

/// Additional package for the original LIBERO, which renders through PyOpenGL, and its library.
const GLES_PACKAGE: &str = "libgles2";
const GLES_LIBRARY: &str = "libGLESv2.so.2";

/// Browser: name of both the Debian package and the program.
const BROWSER_PACKAGE: &str = "chromium";

/// Scheduler: Debian packages, and the programs whose presence shows that the packages are
/// installed.
const SLURM_PACKAGES: [&str; 4] = ["slurmctld", "slurmd", "slurm-client", "munge"];
const SLURM_DAEMONS: [&str; 3] = ["slurmctld", "slurmd", "munged"];

/// Sets up the machine, skipping completed steps. Returns the cache folder.
pub(crate) fn run(root: &Path) -> Result<PathBuf> {
    let cache = linker(root)?;
    sources(&cache)?;
    Ok(cache)
}

/// Sets up what a build needs. Returns the cache folder.
pub(crate) fn linker(root: &Path) -> Result<PathBuf> {
    println!("Setting up");
    let cache = cache_dir()?;
    step("tools", tools)?;
    provide(&WHEELS[..1], &cache)?;
    step("libmujoco for the linker", || link_mujoco(root, &cache))?;
    Ok(cache)
}

/// Fetches the files that scenes are made from.
pub(crate) fn sources(cache: &Path) -> Result<()> {
    provide(&WHEELS[1..], cache)
}

fn provide(wheels: &[Wheel], cache: &Path) -> Result<()> {
    wheels.iter().try_for_each(|wheel| step(wheel.requirement, || wheel.provide(cache)).map(drop))
}

/// Fetches LIBERO's assets into the user's cache folder, as far as `tasks` (SUITE/N, separated by
/// commas, or `all`) need them, and returns the folder. `programs` is the folder with the worker,
/// which does the fetching.
pub(crate) fn assets(programs: &Path, tasks: &str) -> Result<PathBuf> {
    let worker = || Command::new(programs.join("worker"));
    println!("  LIBERO's assets");
    run_command(worker().args(["assets", "fetch", "--tasks", tasks]))?;
    capture(worker().args(["assets", "--path"])).map(PathBuf::from)
}

/// Returns the given folder of LIBERO's assets, else fetches a task's assets and returns their
/// folder.
pub(crate) fn assets_or(root: &Path, given: Option<&Path>, task: &str) -> Result<PathBuf> {
    match given {
        Some(folder) => Ok(folder.to_owned()),
        None => assets(&build_programs(root)?, task),
    }
}

/// Installs the libraries for off-screen OpenGL rendering.
pub(crate) fn opengl() -> Result<()> {
    step("OpenGL without a screen", gl_packages).map(|_| ())
}

/// Installs the libraries with which the original LIBERO renders: PyOpenGL needs one more library.
pub(crate) fn original_packages() -> Result<&'static str> {
    gl_packages()?;
    if known_libraries().contains(GLES_LIBRARY) {
        return Ok("already there");
    }
    install(&[GLES_PACKAGE])?;
    Ok("installed")
}

/// Installs the browser for the live page's tests.
pub(crate) fn browser() -> Result<&'static str> {
    if capture(Command::new(BROWSER_PACKAGE).arg("--version")).is_ok() {
        return Ok("already there");
    }
    install(&[BROWSER_PACKAGE])?;
    Ok("installed")
}

/// Installs the scheduler for the tests of `deploy/slurm`.
pub(crate) fn slurm() -> Result<&'static str> {
    let is_installed = |program: &str| {
        let daemon = Path::new("/usr/sbin").join(program);
        daemon.is_file() || capture(Command::new("which").arg(program)).is_ok()
    };
    if SLURM_DAEMONS.into_iter().all(is_installed) {
        return Ok("already there");
    }
    install(&SLURM_PACKAGES)?;
    Ok("installed")
}

fn cache_dir() -> Result<PathBuf> {
    let cache = terminal::cache_folder();
    std::fs::create_dir_all(&cache).with_context(|| format!("make {}", cache.display()))?;
    Ok(cache)
}

fn tools() -> Result<String> {
    let pip = capture(Command::new("python3").args(["-m", "pip", "--version"]))
        .context("find Python 3 with pip (Debian: `apt-get install python3-pip`)")?;
    capture(Command::new("cc").arg("--version"))
        .context("find a C compiler (Debian: `apt-get install build-essential`)")?;
    let version = pip.split_whitespace().nth(1).unwrap_or("?").to_owned();
    Ok(format!("cc, pip {version}"))
}

/// Links `.deps/mujoco`, which `.cargo/config.toml` passes to the linker.
fn link_mujoco(root: &Path, cache: &Path) -> Result<&'static str> {
    let library = cache.join("mujoco-3.3.7");
    let plain = library.join("libmujoco.so");
    if !plain.exists() {
        std::os::unix::fs::symlink("libmujoco.so.3.3.7", &plain)
            .with_context(|| format!("make {}", plain.display()))?;
    }
    let link = root.join(".deps/mujoco");
    if std::fs::read_link(&link).is_ok_and(|target| target == library) {
        return Ok("already there");
    }
    std::fs::create_dir_all(root.join(".deps"))?;
    if link.is_dir() && !link.is_symlink() {
        std::fs::remove_dir_all(&link)
    } else {
        std::fs::remove_file(&link)
    }
    .or_else(|error| match error.kind() {
        std::io::ErrorKind::NotFound => Ok(()),
        _ => Err(error),
    })
    .with_context(|| format!("replace {}", link.display()))?;
    std::os::unix::fs::symlink(&library, &link)
        .with_context(|| format!("make {}", link.display()))?;
    Ok("linked")
}

fn gl_packages() -> Result<&'static str> {
    if gl_libraries_present() {
        return Ok("already there");
    }
    install(&GL_PACKAGES)?;
    run_command(&mut Command::new("ldconfig"))?;
    if !gl_libraries_present() {
        bail!("find {} after installing them", GL_LIBRARIES.join(", "));
    }
    Ok("installed")
}

/// Installs Debian packages, which requires root.
fn install(packages: &[&str]) -> Result<()> {
    let manual_command = format!("apt-get install --yes {}", packages.join(" "));
    let is_root = capture(Command::new("id").arg("-u")).is_ok_and(|id| id == "0");
    if !is_root {
        bail!("install missing packages: run `sudo {manual_command}`, then run this command again");
    }
    let apt_get = |arguments: &[&str]| {
        let mut apt = Command::new("apt-get");
        apt.args(arguments).env("DEBIAN_FRONTEND", "noninteractive");
        capture(&mut apt).with_context(|| format!("install packages (by hand: `{manual_command}`)"))
    };
    apt_get(&["update"])?;
    apt_get(&[&["install", "--yes", "--no-install-recommends"], packages].concat())?;
    Ok(())
}

/// Returns the dynamic linker's list of libraries.
fn known_libraries() -> String {
    ["ldconfig", "/sbin/ldconfig"]
        .iter()
        .find_map(|program| capture(Command::new(program).arg("-p")).ok())
        .unwrap_or_default()
}

fn gl_libraries_present() -> bool {
    let known = known_libraries();
    GL_LIBRARIES.iter().all(|library| known.contains(library))
}
