//! Packs the staged folder into one archive file, with the archive's checksum in a file beside it.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::capture;
use crate::step::step;

use super::release::{VERSION, commit_time};
use super::stage::{self, Staged};

/// File with the digests of all other files of the archive.
pub(super) const SUMS: &str = "SHA256SUMS";

pub(super) struct Archive {
    pub(super) file: PathBuf,
    /// Name of the archive's top-level folder.
    pub(super) name: String,
    pub(super) staged: Staged,
}

pub(super) fn make(root: &Path, cache: &Path, programs: &Path, output: &Path) -> Result<Archive> {
    println!("Packing");
    let name = format!("rollout-{VERSION}-{}-linux", std::env::consts::ARCH);
    let folder = output.join(&name);
    let _ = std::fs::remove_dir_all(&folder);
    let staged = stage::fill(root, cache, programs, &folder)?;
    step("checksums", || {
        let files = stage::files(&folder)?;
        let mut sums = Command::new("sha256sum");
        let sums = capture(sums.current_dir(&folder).args(&files))?;
        std::fs::write(folder.join(SUMS), sums + "\n")?;
        Ok(format!("of {} files", files.len()))
    })?;
    let file = output.join(format!("{name}.tar.gz"));
    step("archive", || {
        let mut tar = Command::new("tar");
        tar.args(["--create", "--gzip", "--sort=name", "--format=gnu"])
            .args(["--owner=0", "--group=0", "--numeric-owner"])
            .args(["--mode=u+rw,go-w,a+rX", "--mtime"])
            .arg(format!("@{}", commit_time(root)))
            .arg("--directory")
            .arg(output)
            .arg("--file")
            .args([&file, Path::new(&name)]);
        capture(&mut tar).map(|_| "packed")
    })?;
    Ok(Archive { file, name, staged })
}

/// Prints a file's path, size and digest, and writes the digest beside it.
pub(super) fn describe(file: &Path) -> Result<()> {
    let digest = digest(file)?;
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let checksum_file = file.with_file_name(format!("{name}.sha256"));
    std::fs::write(&checksum_file, format!("{digest}  {name}\n"))
        .with_context(|| format!("write {}", checksum_file.display()))?;
    let megabytes = file.metadata()?.len() as f64 / 1e6;
    println!("{} ({megabytes:.1} MB)", file.display());
    println!("SHA-256 {digest}");
    Ok(())
}

pub(crate) fn digest(path: &Path) -> Result<String> {
    let line = capture(Command::new("sha256sum").arg(path))?;
    let digest = line.trim_start_matches('\\').split(' ').next().unwrap_or_default();
    Ok(digest.to_owned())
}
