//! Checks and fetches the requirements of a build of the workspace. No package manager of the
//! system is called: messages name what is missing.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::cargo::build_programs;
use crate::packages::{WHEELS, Wheel};
use crate::process::{capture, run as run_command};
use crate::step::step;

/// Packages of what may be missing, for apt, dnf and conda (from conda-forge).
const PACKAGES: [(&str, [&str; 3]); 4] = [
    ("cc", ["build-essential", "gcc gcc-c++", "c-compiler cxx-compiler binutils"]),
    ("pip", ["python3-pip python3-venv", "python3-pip", "python pip"]),
    ("npm", ["npm", "npm", "nodejs"]),
    (
        "OpenGL",
        [
            "libegl1 libgl1 libgl1-mesa-dri libgles2 libopengl0",
            "libglvnd-egl libglvnd-gles libglvnd-glx libglvnd-opengl mesa-dri-drivers mesa-libEGL",
            "libegl libgl libgles libopengl mesalib",
        ],
    ),
];

/// Libraries with which `worker --renderer gl` and, with the last, the original LIBERO draw.
const GL_LIBRARIES: [&str; 4] = ["libEGL.so.1", "libGL.so.1", "libOpenGL.so.0", "libGLESv2.so.2"];

/// Sets up the machine, skipping completed steps. Returns the cache folder.
pub(crate) fn run(root: &Path) -> Result<PathBuf> {
    let cache = for_building(root)?;
    sources(&cache)?;
    Ok(cache)
}

/// Sets up what a build needs. Returns the cache folder.
pub(crate) fn for_building(root: &Path) -> Result<PathBuf> {
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

pub(crate) fn opengl() -> Result<()> {
    step("OpenGL without a screen", || {
        let known = ["ldconfig", "/sbin/ldconfig"]
            .iter()
            .find_map(|program| capture(Command::new(program).arg("-p")).ok())
            .unwrap_or_default();
        match GL_LIBRARIES.into_iter().find(|library| !known.contains(library)) {
            Some(library) => bail!("find {library} ({})", remedy("OpenGL")),
            None => Ok("there"),
        }
    })
    .map(drop)
}

/// Returns the commands that install what is missing, one of [`PACKAGES`].
pub(crate) fn remedy(missing: &str) -> String {
    let packages = PACKAGES.iter().find(|(name, _)| *name == missing);
    let [apt, dnf, conda] = packages.expect("the table has it").1;
    format!(
        "`apt-get install {apt}`, `dnf install {dnf}`, or `conda install -c conda-forge {conda}`"
    )
}

fn cache_dir() -> Result<PathBuf> {
    let cache = terminal::cache_folder();
    std::fs::create_dir_all(&cache).with_context(|| format!("make {}", cache.display()))?;
    Ok(cache)
}

fn tools() -> Result<String> {
    let pip = capture(Command::new("python3").args(["-m", "pip", "--version"]))
        .with_context(|| format!("find Python 3 with pip ({})", remedy("pip")))?;
    capture(Command::new("cc").arg("--version"))
        .with_context(|| format!("find a C compiler ({})", remedy("cc")))?;
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
