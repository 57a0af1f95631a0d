//! A copy of the database while it is used.

use std::path::Path;
use std::sync::Arc;

use tokio::sync::{Mutex, OwnedMutexGuard};

use super::error::QueueError;
use crate::store::{Store, backup};

/// A finished copy. It is removed when this is dropped; the next one may be made
/// then.
#[derive(Debug)]
pub struct Backup {
    copy: backup::Copy,
    _turn: OwnedMutexGuard<()>,
}

impl Backup {
    /// The file.
    pub fn path(&self) -> &Path {
        self.copy.path()
    }

    /// Copies what is committed now, if nobody else is at it.
    pub(crate) async fn make(store: &Store, turns: &Arc<Mutex<()>>) -> Result<Backup, QueueError> {
        let turn = turns.clone().try_lock_owned();
        let turn = turn.map_err(|_| QueueError::BackupInHand)?;
        Ok(Backup {
            copy: store.backup().await?,
            _turn: turn,
        })
    }
}
