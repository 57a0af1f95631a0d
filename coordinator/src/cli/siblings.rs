//! Paths of the release's other programs, which are installed in the same folder as this program.

use std::path::PathBuf;

use anyhow::{Context, anyhow};

/// Returns the path of a program in this program's folder.
pub(super) fn sibling(name: &str) -> anyhow::Result<PathBuf> {
    let executable = std::env::current_exe().context("find this program's own file")?;
    let path = executable.with_file_name(name);
    match path.is_file() {
        true => Ok(path),
        false => {
            let error = anyhow!(
                "{} is not there; the wheel and the archive of a release install all programs into \
                 one folder, and `cargo build --workspace --bins` builds them in a checkout",
                path.display()
            );
            Err(error.context(format!("find `{name}` beside this program")))
        }
    }
}
