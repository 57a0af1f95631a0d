//! Name and programs of a release.

use std::path::Path;
use std::process::Command;

use crate::process::capture;

/// The programs, all of which start with nothing but glibc installed.
pub(super) const PROGRAMS: [&str; 3] = ["coordinator", "policy-gateway", "worker"];

/// The version of the workspace.
pub(super) const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Time of the commit, in seconds since 1970: the time of all files, so that the same
/// commit makes the same archive.
pub(super) fn commit_time(root: &Path) -> String {
    let mut git = Command::new("git");
    git.current_dir(root).args(["log", "-1", "--format=%ct"]);
    capture(&mut git).unwrap_or_else(|_| "0".to_owned())
}
