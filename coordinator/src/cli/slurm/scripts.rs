//! Writes the filled-in scripts to disk and submits them to Slurm.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, ensure};

use super::super::command::print_line;
use super::super::files::write_atomically;

/// Script with all placeholders filled in.
pub(super) struct Script {
    pub(super) path: PathBuf,
    pub(super) text: String,
}

/// Writes the scripts. Writes nothing if one of the files exists with other content.
pub(super) fn write(scripts: &[Script]) -> anyhow::Result<()> {
    for Script { path, text } in scripts {
        let existing = std::fs::read(path);
        ensure!(
            !path.exists() || existing.is_ok_and(|existing| existing == text.as_bytes()),
            "write {}: the file exists with other content, perhaps edited; remove it, or name \
             another folder",
            path.display()
        );
    }
    for Script { path, text } in scripts {
        let folder = path.parent().unwrap_or(path);
        std::fs::create_dir_all(folder).with_context(|| format!("make {}", folder.display()))?;
        write_atomically(path, text.as_bytes())?;
    }
    Ok(())
}

/// Submits all scripts but the coordinator's. A job starts only once the previously submitted job
/// has started, since workers have no work until their gateway runs.
pub(super) fn submit(scripts: &[Script]) -> anyhow::Result<()> {
    let mut previous_job: Option<String> = None;
    for Script { path, .. } in scripts.iter().skip(1) {
        let mut sbatch = Command::new("sbatch");
        sbatch.arg("--parsable");
        sbatch.args(previous_job.map(|job| format!("--dependency=after:{job}")));
        let output = sbatch.arg(path).output();
        let output = output.context("run sbatch: use a machine that has Slurm's commands")?;
        let error_text = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "submit {}: {}", path.display(), error_text.trim());
        let printed = String::from_utf8_lossy(&output.stdout);
        // With several clusters, `sbatch --parsable` prints `JOB;CLUSTER`.
        let job = printed.trim().split(';').next().unwrap_or_default().to_owned();
        print_line(&format!("submitted {} as job {job}", path.display()))?;
        previous_job = Some(job);
    }
    Ok(())
}
