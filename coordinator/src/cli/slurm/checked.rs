//! Validation of values that are written into a script; errors name the flag or the path.

use std::path::{Path, PathBuf, absolute};

use anyhow::{Context, anyhow};

use super::super::command::{CommandError, usage};

/// Returns the absolute path, since the jobs run in another working directory.
pub(super) fn absolute_path(path: &Path) -> Result<PathBuf, CommandError> {
    let absolute = absolute(path).with_context(|| format!("find {}", path.display()));
    absolute.map_err(usage)
}

/// Returns a path as UTF-8, since a script is UTF-8 text.
pub(super) fn path_text(path: &Path) -> Result<String, CommandError> {
    let text = path.to_str().map(str::to_owned);
    text.ok_or_else(|| usage(anyhow!("use {}: its name is not UTF-8", path.display())))
}

/// Accepts a value without control characters, so that it cannot break its line of the script.
pub(super) fn one_line(flag: &str, value: String) -> Result<String, CommandError> {
    match value.chars().any(char::is_control) {
        true => Err(usage(anyhow!(
            "use {flag} {value:?}: write it on one line, without control characters"
        ))),
        false => Ok(value),
    }
}

/// Accepts a name or number for Slurm, such as a partition or a memory size.
pub(super) fn slurm_word(
    flag: &str,
    value: Option<&String>,
) -> Result<Option<String>, CommandError> {
    let Some(value) = value else { return Ok(None) };
    let is_plain_char = |c: char| c.is_alphanumeric() || "_-+.,:=@/".contains(c);
    match !value.is_empty() && value.chars().all(is_plain_char) {
        true => Ok(Some(value.clone())),
        false => {
            Err(usage(anyhow!("use {flag} {value:?}: write only letters, digits and _-+.,:=@/")))
        }
    }
}

/// Accepts extra `sbatch` options; each must begin with a dash.
pub(super) fn sbatch_options(flag: &str, given: &[String]) -> Result<Vec<String>, CommandError> {
    let option = |option: &String| match option.starts_with('-') {
        true => one_line(flag, option.clone()),
        false => Err(usage(anyhow!(
            "use {flag} {option:?}: write an option of sbatch, such as {flag}=--constraint=avx2"
        ))),
    };
    given.iter().map(option).collect()
}
