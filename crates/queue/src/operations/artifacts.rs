//! Videos of committed outcomes, stored below the data folder. Each video is written under a
//! temporary name and then renamed, so that a file under its final name is complete.

use std::io;
use std::path::{Path, PathBuf};

use benchmark::attempt::AttemptId;
use tempfile::TempPath;
use tokio::fs::File;
use tokio::io::AsyncWriteExt;

use super::context::Context;
use super::shared::Shared;
use crate::queue::Queue;
use crate::store::StoreError;
use crate::store::artifacts::{self, ArtifactOwner};
use crate::store::failpoint::Step;

/// Largest video, bytes. A 520-step rollout filmed by two 512² cameras takes
/// about 8 MiB.
pub const MAX_ARTIFACT_BYTES: u64 = 64 << 20;
pub const ARTIFACTS_FOLDER: &str = "artifacts";
/// Prefix of folders and files of a campaign that is being imported or exported.
pub const MOVING_PREFIX: &str = "moving-";
/// Suffix of a file's name while it is being received.
pub(super) const PARTIAL_SUFFIX: &str = ".partial";

#[derive(Debug, thiserror::Error)]
pub enum ArtifactError {
    #[error("store the video of attempt {attempt}: it is larger than {MAX_ARTIFACT_BYTES} bytes")]
    TooLarge { attempt: AttemptId },
    #[error("store the video of attempt {attempt}: this attempt has no committed outcome")]
    NoOutcome { attempt: AttemptId },
    #[error("write {}: make room on the disk, and make the folder writable for this user", path.display())]
    Write { path: PathBuf, source: io::Error },
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// A video being received. Dropping it removes the partial file.
pub struct Upload<'a> {
    shared: &'a Shared,
    attempt: AttemptId,
    /// Final path of the video, below the data folder.
    path: String,
    partial: TempPath,
    file: File,
    size_bytes: u64,
}

impl Queue {
    /// Starts receiving the video of an attempt whose outcome is committed.
    pub async fn upload(&self, attempt: AttemptId) -> Result<Upload<'_>, ArtifactError> {
        let shared = &*self.shared;
        let mut view = shared.store.read().await?;
        let owner = artifacts::owner(&mut view, attempt).await?;
        drop(view);
        let path = relative_path(&owner.ok_or(ArtifactError::NoOutcome { attempt })?, attempt);
        let target = shared.store.folder().join(&path);
        let folder = target.parent().unwrap_or(Path::new("."));
        tokio::fs::create_dir_all(folder).await.map_err(write_error(folder))?;
        // Every upload has its own temporary file, even two uploads of one attempt.
        let partial = tempfile::Builder::new().suffix(PARTIAL_SUFFIX).tempfile_in(folder);
        let (file, partial) = partial.map_err(write_error(folder))?.into_parts();
        Ok(Upload { shared, attempt, path, partial, file: File::from_std(file), size_bytes: 0 })
    }
}

impl Upload<'_> {
    pub async fn write(&mut self, data: &[u8]) -> Result<(), ArtifactError> {
        self.size_bytes += data.len() as u64;
        if self.size_bytes > MAX_ARTIFACT_BYTES {
            let attempt = self.attempt;
            return Err(ArtifactError::TooLarge { attempt });
        }
        let written = self.file.write_all(data).await;
        written.map_err(write_error(&self.partial))
    }

    /// Moves the complete file into place. Returns its path below the data folder.
    pub async fn finish(mut self) -> Result<String, ArtifactError> {
        // Writes run in the background; only a flush reports a failure of the last one.
        self.file.flush().await.map_err(write_error(&self.partial))?;
        self.file.sync_all().await.map_err(write_error(&self.partial))?;
        let attempt = self.attempt;
        let mut context = Context::begin(self.shared, vec![Step::Artifact]).await?;
        let owner = artifacts::owner(&mut context.tx, attempt).await?;
        let owner = owner.ok_or(ArtifactError::NoOutcome { attempt })?;
        let now = context.now;
        artifacts::record(&mut context.tx, attempt, &self.path, self.size_bytes, now).await?;
        let _guard = self.shared.files.lock().await;
        let target = self.shared.store.folder().join(&self.path);
        let renamed = self.partial.persist(&target);
        renamed.map_err(|failed| write_error(&target)(failed.error))?;
        context.commit().await?;
        self.shared.films.filmed(owner.campaign, owner.job);
        Ok(self.path)
    }
}

/// Returns the path of a campaign's folder, below the data folder.
pub(crate) fn campaign_folder(folder: &str) -> String {
    format!("{ARTIFACTS_FOLDER}/{folder}")
}

/// Removes partial files of uploads, imports and exports that an earlier run left behind.
pub fn remove_partial_files(data: &Path) -> io::Result<()> {
    for entry in std::fs::read_dir(data)? {
        let entry = entry?;
        if entry.file_name().to_string_lossy().starts_with(MOVING_PREFIX) {
            match entry.file_type()?.is_dir() {
                true => std::fs::remove_dir_all(entry.path())?,
                false => std::fs::remove_file(entry.path())?,
            }
        }
    }
    let campaigns = data.join(ARTIFACTS_FOLDER);
    if !campaigns.exists() {
        return Ok(());
    }
    for campaign in std::fs::read_dir(campaigns)? {
        let campaign = campaign?;
        if !campaign.file_type()?.is_dir() {
            continue;
        }
        for file in std::fs::read_dir(campaign.path())? {
            let file = file?;
            if file.file_name().to_string_lossy().ends_with(PARTIAL_SUFFIX) {
                std::fs::remove_file(file.path())?;
            }
        }
    }
    Ok(())
}

/// Returns a path such as `artifacts/FOLDER/spatial_t0_camera_L2_c00.r0.ATTEMPT.mp4`. The slashes
/// of a rollout id become underscores; a campaign's folder name holds no slash.
fn relative_path(owner: &ArtifactOwner, attempt: AttemptId) -> String {
    format!(
        "{}/{}.r{}.{attempt}.mp4",
        campaign_folder(&owner.folder),
        owner.rollout_id.replace('/', "_"),
        owner.replicate,
    )
}

fn write_error(path: &Path) -> impl FnOnce(io::Error) -> ArtifactError {
    let path = path.to_owned();
    move |source| ArtifactError::Write { path, source }
}
