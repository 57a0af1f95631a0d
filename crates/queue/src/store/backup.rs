//! Backup of the database while it is in use: one consistent view, compacted, without stopping the
//! writer.

use std::io;
use std::path::Path;

use tempfile::TempPath;

use super::{Doing, Store, StoreError};

const BACKUP_FILE: &str = "backup.partial";

/// Copies the committed state into a file that is removed when the returned path is dropped. The
/// caller ensures that only one copy is made at a time.
pub(crate) async fn copy(store: &Store) -> Result<TempPath, StoreError> {
    remove_leftover(store.folder());
    let mut reader = store.reader().await?;
    // Dropping the path on an error removes an incomplete copy.
    let copy = copy_path(store).map_err(sqlx::Error::Io);
    let copy = copy.doing("copy the database")?;
    sqlx::query("VACUUM INTO ?")
        .bind(copy.display().to_string())
        .execute(&mut *reader)
        .await
        .doing("copy the database")?;
    Ok(copy)
}

/// Returns the path of the copy: in the data folder, whose disk is expected to have room, or among
/// temporary files if the data folder is gone.
fn copy_path(store: &Store) -> io::Result<TempPath> {
    if store.is_in_place() {
        return TempPath::try_from_path(store.folder().join(BACKUP_FILE));
    }
    // Other users can write to the temporary folder, so the file is private and has a random name.
    let copy = tempfile::Builder::new().prefix("rollout-").suffix(BACKUP_FILE).tempfile()?;
    Ok(copy.into_temp_path())
}

/// Removes the incomplete copy of a process that was killed.
pub(crate) fn remove_leftover(folder: &Path) {
    // Usually there is no such file. If the file cannot be removed, the next backup overwrites it
    // or reports the error.
    let _ = std::fs::remove_file(folder.join(BACKUP_FILE));
}
