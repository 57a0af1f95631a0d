//! Backup of the database while it is in use.

use std::path::Path;

use tempfile::TempPath;
use tokio::sync::OwnedMutexGuard;

use super::error::QueueError;
use crate::queue::Queue;
use crate::store::backup;

/// A finished backup. Its file is removed on drop; only then can the next backup be made.
#[derive(Debug)]
pub struct Backup {
    copy: TempPath,
    _guard: OwnedMutexGuard<()>,
}

impl Backup {
    pub fn path(&self) -> &Path {
        &self.copy
    }
}

impl Queue {
    pub async fn backup(&self) -> Result<Backup, QueueError> {
        let guard = self.backups.clone().try_lock_owned();
        let guard = guard.map_err(|_| QueueError::BackupInHand)?;
        Ok(Backup { copy: backup::copy(&self.shared.store).await?, _guard: guard })
    }
}
