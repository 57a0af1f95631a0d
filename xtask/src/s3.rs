//! S3 server for the tests of storing videos in a bucket.

use std::path::{Path, PathBuf};

use crate::step::step;
use crate::venv::environment;

const PACKAGES: [&str; 1] = ["moto[server]==5.2.5"];

/// Returns the server's program; `None` if it cannot be installed, in which case the tests report
/// that they are skipped.
pub(crate) fn server(cache: &Path) -> Option<PathBuf> {
    let dir = cache.join("s3-venv");
    let outcome = step("S3 server", || {
        let outcome = environment(&dir, &PACKAGES).map(str::to_owned);
        Ok(outcome.unwrap_or_else(|error| format!("none: {error:#}")))
    });
    let is_installed = outcome.is_ok_and(|status| !status.starts_with("none"));
    is_installed.then(|| dir.join("bin/moto_server"))
}
