//! `cargo xtask dist`: an archive of the programs with everything that they need except glibc.

mod archive;
mod bare_root;
mod check;
mod licences;
mod native;
mod release;
mod stage;

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::cargo::{build_programs, build_released_programs};
use crate::process::{capture, run as run_command};
use crate::setup;

pub(crate) use archive::digest;
pub(crate) use check::test;
use release::PROGRAMS;

/// Options of `cargo xtask dist`.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// `dev` packs programs of the development profile, to try the packing itself.
    #[arg(long, default_value = "release")]
    profile: Profile,
    /// Also builds a container image, with this program: `podman`, `docker` or `buildah`.
    #[arg(long, value_name = "PROGRAM", num_args = 0..=1, default_missing_value = "podman")]
    image: Option<String>,
    /// Folder of the archive. [default: target/dist]
    #[arg(long)]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum Profile {
    Release,
    Dev,
}

/// Makes the archive, tests it in a bare root, and prints its path.
pub(crate) fn run(root: &Path, options: &Options) -> Result<()> {
    let cache = setup::run(root)?;
    if options.profile == Profile::Release {
        refuse_uncommitted_changes(root)?;
        licences::tool(root)?;
    }
    let programs = match options.profile {
        Profile::Release => build_released_programs(root, &PROGRAMS)?,
        Profile::Dev => build_programs(root)?,
    };
    let output = options.output.clone();
    let output = output.unwrap_or_else(|| root.join("target/dist"));
    let archive = archive::make(root, &cache, &programs, &output)?;
    check::check_archive(root, &archive)?;
    archive::describe(&archive.file)?;
    if let Some(program) = &options.image {
        let mut build = Command::new(program);
        build.args(["build", "--tag", &format!("rollout:{}", release::VERSION), "--file"]);
        build.arg(root.join("deploy/container/Containerfile"));
        run_command(build.arg(output.join(&archive.name)))?;
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
