//! `cargo xtask dist`: the release. An archive of the programs with everything that they need except
//! glibc, the same as a wheel, and the wheels of the Python packages.

mod archive;
mod bare_root;
mod check;
mod licences;
mod native;
mod release;
mod stage;

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};

use crate::cargo::{GLIBC, build_programs, build_released_programs};
use crate::process::capture;
use crate::setup;
use crate::wheel::{self, Profile};

pub(crate) use archive::digest;
pub(crate) use check::test;
pub(crate) use release::{PROGRAMS, VERSION};
pub(crate) use stage::{Staged, fill};

/// Options of `cargo xtask dist`.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// `dev` packs programs of the development profile, to try the packing itself.
    #[arg(long, default_value = "release")]
    profile: Profile,
    /// Folder of the archive and the wheels. [default: target/dist]
    #[arg(long)]
    output: Option<PathBuf>,
}

/// Makes the archive and the wheels, tests the archive in a bare root, and prints all paths.
pub(crate) fn run(root: &Path, options: &Options) -> Result<()> {
    let cache = setup::run(root)?;
    let programs = match options.profile {
        Profile::Release => {
            refuse_uncommitted_changes(root)?;
            licences::tool(root)?;
            build_released_programs(root, &wheel::tools(&cache)?, &PROGRAMS)?
        }
        Profile::Dev => build_programs(root)?,
    };
    let output = options.output.clone();
    let output = output.unwrap_or_else(|| root.join("target/dist"));
    let archive = archive::make(root, &cache, &programs, &output)?;
    let Staged { glibc, libraries, .. } = &archive.staged;
    if options.profile == Profile::Release {
        ensure!(
            *glibc <= GLIBC && libraries.is_empty(),
            "make a release: the programs need glibc {}.{} and {libraries:?}",
            glibc.0,
            glibc.1
        );
    }
    check::check_archive(root, &archive)?;
    archive::describe(&archive.file)?;
    let wheels = output.join("wheels");
    for file in wheel::build(root, &cache, options.profile, Some(&archive.staged), &wheels)? {
        archive::describe(&file)?;
    }
    Ok(())
}

/// Refuses uncommitted changes, because a release names its commit.
fn refuse_uncommitted_changes(root: &Path) -> Result<()> {
    let mut git = Command::new("git");
    git.current_dir(root).args(["status", "--porcelain"]);
    let changes = capture(&mut git).context("list uncommitted changes")?;
    if let Some(first) = changes.lines().next() {
        bail!("make a release: {first:?} is not committed; commit it, or use `--profile dev`");
    }
    Ok(())
}
