//! Unmodified clients of LIBERO from the package index, for the shim's tests.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::process::capture;
use crate::step::step;
use crate::venv::{new_environment, pip};

/// CPU builds of PyTorch. The package index only has builds with gigabytes of CUDA.
const TORCH: [&str; 2] = ["torch==2.10.0", "torchvision==0.25.0"];
const TORCH_INDEX: &str = "https://download.pytorch.org/whl/cpu";
/// The clients, installed without dependencies: they require many packages that an episode does
/// not import.
const CLIENTS: [&str; 3] = ["vla-eval==0.8.0", "lerobot==0.4.4", "rlinf==0.3.0"];
/// File that marks an environment as complete; holds the list of its packages.
const STAMP: &str = "installed.txt";

/// Returns the interpreter of an environment with the clients; `None` if it cannot be made, in
/// which case the tests report that they are skipped.
pub(crate) fn provide(root: &Path, cache: &Path) -> Option<PathBuf> {
    let dir = cache.join("clients");
    let outcome = step("vla-eval, lerobot, torchrl, rlinf", || {
        let outcome = install(root, &dir);
        Ok(outcome.unwrap_or_else(|error| format!("none: {error:#}")))
    });
    let python = dir.join("bin/python");
    (outcome.is_ok() && dir.join(STAMP).exists()).then_some(python)
}

fn install(root: &Path, dir: &Path) -> Result<String> {
    let list = root.join("python/tests/shim/clients.txt");
    let dependencies =
        std::fs::read_to_string(&list).with_context(|| format!("read {}", list.display()))?;
    let requirements =
        [&TORCH.join("\n"), &CLIENTS.join("\n"), &dependencies].map(String::as_str).join("\n");
    let stamp = dir.join(STAMP);
    if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == requirements) {
        return Ok("already there".to_owned());
    }
    // An environment of other requirements must not count as complete if this one fails.
    let _ = std::fs::remove_file(&stamp);
    new_environment(dir)?;
    let mut torch = pip(dir);
    torch.args(["--retries", "0", "--timeout", "10", "--index-url", TORCH_INDEX]);
    capture(torch.args(TORCH)).context("install PyTorch (is its index reachable?)")?;
    capture(pip(dir).arg("--requirement").arg(&list))?;
    capture(pip(dir).arg("--no-deps").args(CLIENTS))?;
    std::fs::write(&stamp, requirements).with_context(|| format!("write {}", stamp.display()))?;
    Ok("installed".to_owned())
}
