//! Name and programs of a release.

use std::path::Path;
use std::process::Command;

use crate::process::capture;

/// Programs of a release, all of which run with nothing but glibc installed.
pub(crate) const PROGRAMS: [&str; 3] = ["coordinator", "policy-gateway", "worker"];

pub(crate) const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Returns the commit's time in seconds since 1970. It is the modification time of all files in the
/// archive, so that the archive is reproducible from the commit.
pub(super) fn commit_time(root: &Path) -> String {
    let mut git = Command::new("git");
    git.current_dir(root).args(["log", "-1", "--format=%ct"]);
    capture(&mut git).unwrap_or_else(|_| "0".to_owned())
}
