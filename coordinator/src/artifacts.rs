//! Files kept beside rollouts, below the data folder: written under a temporary
//! name, then renamed, so that a file that is there is whole.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use tokio::fs::File;
use tokio::io::AsyncWriteExt;

use crate::ids::{CampaignName, JobId, LeaseRef};
use crate::queue::Queue;
use crate::store::artifacts::ArtifactOwner;
use crate::store::failpoint::Step;
use crate::store::{StoreError, artifacts};

/// Largest artifact, bytes. A 520-step rollout filmed by two 512² cameras takes
/// about 8 MiB.
pub const MAX_ARTIFACT_BYTES: u64 = 64 << 20;
/// The folder of artifacts in the data folder.
pub const ARTIFACTS_FOLDER: &str = "artifacts";
/// What a file is called while it is being received.
const PARTIAL_SUFFIX: &str = "partial";

/// What is kept beside a rollout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArtifactKind {
    /// What the cameras saw, MP4.
    Video,
}

/// An artifact that is not kept.
#[derive(Debug, thiserror::Error)]
pub enum ArtifactError {
    /// Not a kind of file that is kept.
    #[error("store artifact `{name}`: only `video.mp4` is kept")]
    Name {
        /// What was sent.
        name: String,
    },
    /// Too large.
    #[error("store an artifact of job {job}: it is larger than {MAX_ARTIFACT_BYTES} bytes")]
    TooLarge {
        /// Whose.
        job: JobId,
    },
    /// Neither the lease holder nor the owner of the committed attempt.
    #[error("store an artifact of job {job}: attempt {attempt} of worker `{worker}` neither holds its lease nor committed its result",
        job = lease.job, attempt = lease.attempt, worker = lease.worker)]
    NotTheOwner {
        /// Who asked.
        lease: LeaseRef,
    },
    /// The file cannot be written.
    #[error("write {}: is there room on the disk, and may this user write there?", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// An artifact on its way in. Dropping it leaves nothing but a partial file,
/// which the next upload of the same rollout overwrites.
#[derive(Debug)]
pub struct Upload<'a> {
    queue: &'a Queue,
    lease: LeaseRef,
    kind: ArtifactKind,
    path: String,
    partial: PathBuf,
    file: File,
    size_bytes: u64,
}

impl ArtifactKind {
    fn as_str(self) -> &'static str {
        match self {
            ArtifactKind::Video => "video",
        }
    }

    fn extension(self) -> &'static str {
        match self {
            ArtifactKind::Video => "mp4",
        }
    }
}

impl FromStr for ArtifactKind {
    type Err = ArtifactError;

    fn from_str(name: &str) -> Result<ArtifactKind, ArtifactError> {
        match name {
            "video.mp4" => Ok(ArtifactKind::Video),
            _ => Err(ArtifactError::Name {
                name: crate::ids::shortened(name, 80).to_owned(),
            }),
        }
    }
}

impl<'a> Upload<'a> {
    /// Begins to receive a file.
    ///
    /// # Errors
    /// When the sender does not own the rollout, or the file cannot be made.
    pub async fn begin(
        queue: &'a Queue,
        lease: LeaseRef,
        kind: ArtifactKind,
    ) -> Result<Upload<'a>, ArtifactError> {
        let mut tx = queue.store().read().await?;
        let Some(owner) = artifacts::owner(&mut tx, &lease).await? else {
            return Err(ArtifactError::NotTheOwner { lease });
        };
        drop(tx);
        let path = relative_path(&owner, kind);
        let target = queue.store().folder().join(&path);
        let folder = target.parent().unwrap_or(Path::new(".")).to_owned();
        tokio::fs::create_dir_all(&folder)
            .await
            .map_err(at(&folder))?;
        // The attempt in its name keeps a late upload out of a newer one's way.
        let partial = folder.join(format!(
            "{}.a{}.{PARTIAL_SUFFIX}",
            path.rsplit('/').next().unwrap_or_default(),
            lease.attempt
        ));
        let file = File::create(&partial).await.map_err(at(&partial))?;
        Ok(Upload {
            queue,
            lease,
            kind,
            path,
            partial,
            file,
            size_bytes: 0,
        })
    }

    /// Receives a piece.
    ///
    /// # Errors
    /// When the file grows too large or cannot be written.
    pub async fn write(&mut self, data: &[u8]) -> Result<(), ArtifactError> {
        self.size_bytes += data.len() as u64;
        if self.size_bytes > MAX_ARTIFACT_BYTES {
            return Err(ArtifactError::TooLarge {
                job: self.lease.job,
            });
        }
        self.file.write_all(data).await.map_err(at(&self.partial))
    }

    /// Puts the whole file in its place. Returns its path below the data
    /// folder.
    ///
    /// # Errors
    /// When the sender lost the rollout meanwhile, or the disk fails.
    pub async fn finish(self) -> Result<String, ArtifactError> {
        self.file.sync_all().await.map_err(at(&self.partial))?;
        let mut tx = self.queue.store().write(Step::Artifact).await?;
        if artifacts::owner(&mut tx, &self.lease).await?.is_none() {
            let lease = self.lease.clone();
            return Err(ArtifactError::NotTheOwner { lease });
        }
        let now = self.queue.now();
        let kind = self.kind.as_str();
        artifacts::record(&mut tx, &self.lease, kind, &self.path, self.size_bytes, now).await?;
        let target = self.queue.store().folder().join(&self.path);
        tokio::fs::rename(&self.partial, &target)
            .await
            .map_err(at(&target))?;
        tx.commit().await?;
        Ok(self.path)
    }

    /// Removes what was received; for uploads that end early.
    pub async fn abandon(self) {
        if let Err(error) = tokio::fs::remove_file(&self.partial).await {
            tracing::warn!("failed to remove {}: {error}", self.partial.display());
        }
    }
}

/// The folder of a campaign's files, below the data folder.
pub(crate) fn campaign_folder(campaign: &CampaignName) -> String {
    format!("{ARTIFACTS_FOLDER}/{campaign}")
}

/// Removes what uploads of an earlier run left half-way.
///
/// # Errors
/// When a folder cannot be read or a file cannot be removed.
pub fn remove_partial_files(data: &Path) -> io::Result<()> {
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
            let path = file?.path();
            if path.extension().is_some_and(|end| end == PARTIAL_SUFFIX) {
                std::fs::remove_file(path)?;
            }
        }
    }
    Ok(())
}

impl fmt::Display for ArtifactKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// `artifacts/CAMPAIGN/spatial_t0_camera_L2_c00.r0.mp4`. Rollout ids hold
/// letters, digits, underscores and slashes only, campaign names no slash.
fn relative_path(owner: &ArtifactOwner, kind: ArtifactKind) -> String {
    format!(
        "{}/{}.r{}.{}",
        campaign_folder(&owner.campaign),
        owner.rollout_id.replace('/', "_"),
        owner.replicate,
        kind.extension()
    )
}

fn at(path: &Path) -> impl FnOnce(io::Error) -> ArtifactError {
    let path = path.to_owned();
    move |source| ArtifactError::Write { path, source }
}
