//! Films that are kept beyond the data folder: which are still in it, and forgetting them
//! once they are stored. Where that is, and how, is the caller's business.

use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::artifacts::{ARTIFACTS_FOLDER, PARTIAL_SUFFIX};
use super::removals;
use crate::queue::Queue;
use crate::store::{Doing, StoreError, artifacts};

/// A film that is in the data folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilmHere {
    /// Its path below the data folder.
    pub path: String,
    /// Its file.
    pub file: PathBuf,
    /// Identity of the file when it was found: a film may be sent again.
    identity: (u64, i64, i64),
}

/// State of a film in the data folder after it was stored elsewhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Forgotten {
    /// It is only elsewhere now.
    Gone,
    /// It was sent again and is to be stored once more.
    Replaced,
    /// Its campaign was deleted: it is to be nowhere.
    Deleted,
}

impl Queue {
    /// The whole films that are in the data folder.
    ///
    /// # Errors
    /// When the folder or the database cannot be read.
    pub async fn films_here(&self) -> Result<Vec<FilmHere>, StoreError> {
        let found = walk(self.store().folder()).map_err(sqlx::Error::Io);
        let found = found.doing("list the films in the data folder")?;
        if found.is_empty() {
            return Ok(found);
        }
        let paths: Vec<&str> = found.iter().map(|film| film.path.as_str()).collect();
        let mut view = self.store().read().await?;
        let recorded = artifacts::recorded(&mut view, &paths).await?;
        let is_recorded = |film: &FilmHere| recorded.contains(&film.path);
        Ok(found.into_iter().filter(is_recorded).collect())
    }

    /// Removes a film from the data folder, if it is still the file that was found.
    ///
    /// # Errors
    /// If the film cannot be removed.
    pub async fn forget_film(&self, film: &FilmHere) -> io::Result<Forgotten> {
        let _alone = self.shared.files.lock().await;
        match identity(&film.file) {
            Ok(now) if now == film.identity => {
                std::fs::remove_file(&film.file).map(|()| Forgotten::Gone)
            }
            Ok(_) => Ok(Forgotten::Replaced),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Forgotten::Deleted),
            Err(error) => Err(error),
        }
    }

    /// Removes what is left of deleted campaigns, here and elsewhere. Elsewhere may take its
    /// time or not answer: campaigns come and go meanwhile. Of several callers one works.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn finish_removals(&self) -> Result<(), StoreError> {
        let _alone = self.removing.lock().await;
        // A campaign on its way in has its folder noted until it is here. None is on its way
        // while this is held, and no campaign is ever given a folder that is noted.
        let arriving = self.campaigns.lock().await;
        let pending = removals::pending(&self.shared).await?;
        drop(arriving);
        for folder in pending {
            removals::remove(&self.shared, &folder).await?;
        }
        Ok(())
    }
}

fn walk(data: &Path) -> io::Result<Vec<FilmHere>> {
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
            let name = |path: &Path| {
                path.file_name()
                    .and_then(|it| it.to_str().map(str::to_owned))
            };
            let (Some(folder), Some(name)) = (name(&campaign.path()), name(&file)) else {
                continue;
            };
            if name.ends_with(PARTIAL_SUFFIX) {
                continue;
            }
            // It may have been replaced or removed since.
            if let Ok(identity) = identity(&file) {
                found.push(FilmHere {
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
