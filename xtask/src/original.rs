//! The original LIBERO in Python, with which this simulator is compared. It is installed into its
//! own virtual environment in the cache, as the reference data's README describes.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};

use crate::setup;
use crate::step::step;
use crate::venv;

const PACKAGES: [&str; 15] = [
    "mujoco==3.3.7",
    "numpy",
    "scipy",
    "numba",
    "opencv-python-headless",
    "bddl==1.0.1",
    "easydict",
    "gym",
    "gymnasium",
    "huggingface_hub",
    "pillow",
    "pyyaml",
    "termcolor",
    "future",
    "matplotlib",
];
/// The original's packages. They are installed without the dependencies that they declare, whose
/// versions do not exist for newer Pythons; [`PACKAGES`] suffices.
const ORIGINAL: [&str; 2] = ["robosuite==1.4.0", "hf-libero==0.1.4"];

pub(crate) struct Original {
    python: PathBuf,
    /// Folder of the reference data's scripts.
    tools: PathBuf,
    /// Folder of the installed Python packages.
    packages: PathBuf,
    /// Folder of LIBERO's settings, which name the paths in this environment.
    settings: PathBuf,
}

impl Original {
    pub(crate) fn provide(cache: &Path, oracle: &Path, assets: &Path) -> Result<Self> {
        let tools = oracle.join("tools");
        ensure!(
            tools.join("baseline.py").is_file(),
            "find the original's scripts in {}: give the reference data's folder with --oracle",
            tools.display()
        );
        let assets = assets.canonicalize().with_context(|| {
            format!("find LIBERO's assets at {}: give their folder with --assets", assets.display())
        })?;
        setup::opengl()?;
        let dir = cache.join("original");
        let python = dir.join("bin/python");
        step("the original's Python packages", || {
            venv::with_undeclared(&dir, &PACKAGES, &ORIGINAL)
        })?;
        let packages = venv::site_packages(&python)?;
        let package = packages.join("libero/libero");
        link(&package.join("assets"), &assets)?;
        let settings = dir.join("settings");
        write_settings(&package, &settings)?;
        Ok(Self {
            python,
            // An absolute path, because scripts choose their working folder.
            tools: tools.canonicalize()?,
            packages,
            settings,
        })
    }

    pub(crate) fn packages(&self) -> &Path {
        &self.packages
    }

    pub(crate) fn command(&self, script: &str) -> Command {
        self.script(&self.tools.join(script))
    }

    pub(crate) fn script(&self, script: &Path) -> Command {
        let mut command = Command::new(&self.python);
        command
            .arg(script)
            .env("LIBERO_PACKAGE", &self.packages)
            .env("LIBERO_CONFIG_PATH", &self.settings)
            .env("MUJOCO_GL", "egl")
            // The scripts' folder may be read-only.
            .env("PYTHONDONTWRITEBYTECODE", "1");
        command
    }
}

/// Writes LIBERO's settings, which hold the paths of its folders. Without settings, LIBERO would
/// ask for the paths on standard input.
fn write_settings(package: &Path, settings: &Path) -> Result<()> {
    let folder = |key: &str, name: &str| format!("{key}: {}\n", package.join(name).display());
    let all = [
        folder("benchmark_root", ""),
        folder("bddl_files", "bddl_files"),
        folder("init_states", "init_files"),
        folder("datasets", "../datasets"),
        folder("assets", "assets"),
    ];
    let file = settings.join("config.yaml");
    std::fs::create_dir_all(settings)
        .and_then(|()| std::fs::write(&file, all.concat()))
        .with_context(|| format!("write {}", file.display()))
}

fn link(link: &Path, assets: &Path) -> Result<()> {
    if std::fs::read_link(link).is_ok_and(|target| target == assets) {
        return Ok(());
    }
    if link.is_symlink() {
        std::fs::remove_file(link).with_context(|| format!("replace {}", link.display()))?;
    }
    if link.exists() {
        bail!(
            "link {} to {}: there is a folder of that name; remove it",
            link.display(),
            assets.display()
        );
    }
    std::os::unix::fs::symlink(assets, link).with_context(|| format!("make {}", link.display()))
}
