//! A copy of the database while it is used: one consistent view, compacted,
//! without stopping the writer.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::{Doing, Store, StoreError};

/// The file in the data folder that a copy is made in.
const BACKUP_FILE: &str = "backup.partial";

/// A finished copy, removed when it is dropped.
#[derive(Debug)]
pub(crate) struct Copy {
    path: PathBuf,
}

impl Copy {
    /// Where it lies.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Copy {
    fn drop(&mut self) {
        match std::fs::remove_file(&self.path) {
            // A copy that failed at once left nothing.
            Err(error) if error.kind() != ErrorKind::NotFound => {
                tracing::warn!("failed to remove {}: {error}", self.path.display());
            }
            _ => {}
        }
    }
}

/// Copies what is committed now. One copy at a time: the caller sees to it.
pub(crate) async fn copy(store: &Store) -> Result<Copy, StoreError> {
    let path = store.folder().join(BACKUP_FILE);
    remove_leftover(store.folder());
    let mut reader = store.reader().await?;
    // It is removed even if it is half done.
    let copy = Copy { path };
    sqlx::query("VACUUM INTO ?")
        .bind(copy.path.display().to_string())
        .execute(&mut *reader)
        .await
        .doing("copy the database")?;
    Ok(copy)
}

/// Removes the half-done copy of a process that was killed.
pub(crate) fn remove_leftover(folder: &Path) {
    // It is not there, as a rule; one that stays is overwritten or reported
    // by the next backup.
    let _ = std::fs::remove_file(folder.join(BACKUP_FILE));
}
