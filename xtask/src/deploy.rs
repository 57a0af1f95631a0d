//! Schemas of Kubernetes, for the tests of `deploy`.

use std::path::{Path, PathBuf};

use crate::step::step;
use crate::venv::environment;

const PACKAGES: [&str; 1] = ["kubernetes-validate==1.37.0"];

/// Returns an interpreter with the schemas; `None` if they cannot be installed, in which case the
/// tests report that they are skipped.
pub(crate) fn schemas(cache: &Path) -> Option<PathBuf> {
    let dir = cache.join("deploy-venv");
    let outcome = step("schemas of deploy/", || {
        let outcome = environment(&dir, &PACKAGES).map(str::to_owned);
        Ok(outcome.unwrap_or_else(|error| format!("none: {error:#}")))
    });
    let is_installed = outcome.is_ok_and(|status| !status.starts_with("none"));
    is_installed.then(|| dir.join("bin/python"))
}
