//! A copy of the database while it is used.

use std::path::Path;

use tempfile::TempPath;
use tokio::sync::OwnedMutexGuard;

use super::error::QueueError;
use crate::queue::Queue;
use crate::store::backup;

/// A finished copy. It is removed when this is dropped; the next one may be made
/// then.
#[derive(Debug)]
pub struct Backup {
    copy: TempPath,
    _turn: OwnedMutexGuard<()>,
}

impl Backup {
    /// The file.
    pub fn path(&self) -> &Path {
        &self.copy
    }
}

impl Queue {
    /// Copies the database as it is now, while it is used.
    ///
    /// # Errors
    /// When another copy is being made, the disk is full, or the database
    /// fails.
    pub async fn backup(&self) -> Result<Backup, QueueError> {
        let turn = self.backups.clone().try_lock_owned();
        let turn = turn.map_err(|_| QueueError::BackupInHand)?;
        Ok(Backup {
            copy: backup::copy(&self.shared.store).await?,
            _turn: turn,
        })
    }
}
