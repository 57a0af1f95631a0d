//! Videos that are to be stored remotely: lists the videos still in the data folder, and removes
//! each after the caller has uploaded it.

use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::artifacts::{ARTIFACTS_FOLDER, PARTIAL_SUFFIX};
use super::removals;
use crate::queue::Queue;
use crate::store::{Doing, StoreError, artifacts};

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LocalFilm {
    /// Path below the data folder.
    pub path: String,
    pub file: PathBuf,
    /// Identity of the file when it was listed; it changes if the video is uploaded again.
    identity: (u64, i64, i64),
}

/// Result of removing a local video that has been stored remotely.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilmRemoval {
    /// The file was removed, so only the remote copy is left.
    Removed,
    /// The file was kept: a new upload has replaced it, and it must be stored remotely again.
    Replaced,
    /// The file no longer exists, because its campaign was deleted. The remote copy must be removed
    /// too.
    CampaignDeleted,
}

impl Queue {
    pub async fn local_films(&self) -> Result<Vec<LocalFilm>, StoreError> {
        let found = list_files(self.store().folder()).map_err(sqlx::Error::Io);
        let found = found.doing("list the videos in the data folder")?;
        if found.is_empty() {
            return Ok(found);
        }
        let paths: Vec<&str> = found.iter().map(|film| film.path.as_str()).collect();
        let mut view = self.store().read().await?;
        let recorded = artifacts::recorded(&mut view, &paths).await?;
        let is_recorded = |film: &LocalFilm| recorded.contains(&film.path);
        Ok(found.into_iter().filter(is_recorded).collect())
    }

    /// Removes a video from the data folder, if its file is still the one that was listed.
    pub async fn remove_local_film(&self, film: &LocalFilm) -> io::Result<FilmRemoval> {
        let _guard = self.shared.files.lock().await;
        match identity(&film.file) {
            Ok(now) if now == film.identity => {
                std::fs::remove_file(&film.file).map(|()| FilmRemoval::Removed)
            }
            Ok(_) => Ok(FilmRemoval::Replaced),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                Ok(FilmRemoval::CampaignDeleted)
            }
            Err(error) => Err(error),
        }
    }

    /// Removes the remaining files of deleted campaigns, locally and remotely. Campaigns can be
    /// created and deleted meanwhile, since remote storage may be slow or unavailable. Concurrent
    /// calls run one after the other.
    pub async fn finish_removals(&self) -> Result<(), StoreError> {
        let _guard = self.removing.lock().await;
        // The folder of a campaign that is being imported stays marked for removal until the import
        // is complete. The lock excludes imports while the marked folders are read; no campaign
        // that is created later gets a marked folder.
        let no_imports = self.campaigns.lock().await;
        let pending = removals::pending(&self.shared).await?;
        drop(no_imports);
        for folder in pending {
            removals::remove(&self.shared, &folder).await?;
        }
        Ok(())
    }
}

/// Lists all complete files in the folders of campaigns.
fn list_files(data: &Path) -> io::Result<Vec<LocalFilm>> {
    let mut found = Vec::new();
    let campaigns = match std::fs::read_dir(data.join(ARTIFACTS_FOLDER)) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(found),
        campaigns => campaigns?,
    };
    for campaign in campaigns {
        let campaign = campaign?;
        if !campaign.file_type()?.is_dir() {
            continue;
        }
        for film in std::fs::read_dir(campaign.path())? {
            let file = film?.path();
            let name =
                |path: &Path| path.file_name().and_then(|name| name.to_str().map(str::to_owned));
            let (Some(folder), Some(name)) = (name(&campaign.path()), name(&file)) else {
                continue;
            };
            if name.ends_with(PARTIAL_SUFFIX) {
                continue;
            }
            // The file may have been replaced or removed since it was listed.
            if let Ok(identity) = identity(&file) {
                found.push(LocalFilm {
                    path: format!("{ARTIFACTS_FOLDER}/{folder}/{name}"),
                    file,
                    identity,
                });
            }
        }
    }
    found.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(found)
}

fn identity(file: &Path) -> io::Result<(u64, i64, i64)> {
    let metadata = std::fs::metadata(file)?;
    Ok((metadata.ino(), metadata.mtime(), metadata.mtime_nsec()))
}
