//! A copy of the database while it is used: one consistent view, compacted,
//! without stopping the writer.

use std::path::{Path, PathBuf};

use tempfile::TempPath;

use super::{Doing, Store, StoreError};

/// The file in the data folder that a copy is made in.
const BACKUP_FILE: &str = "backup.partial";

/// Copies what is committed now into a file that is removed when its path is
/// dropped. One copy at a time: the caller sees to it.
pub(crate) async fn copy(store: &Store) -> Result<TempPath, StoreError> {
    remove_leftover(store.folder());
    let mut reader = store.reader().await?;
    // It is removed even if it is half done.
    let copy = TempPath::try_from_path(place(store));
    let copy = copy.map_err(sqlx::Error::Io).doing("copy the database")?;
    sqlx::query("VACUUM INTO ?")
        .bind(copy.display().to_string())
        .execute(&mut *reader)
        .await
        .doing("copy the database")?;
    Ok(copy)
}

/// The copy's path: in the data folder, whose disk has room for it, or among temporary
/// files if the data folder is gone and the copy is all that will be left.
fn place(store: &Store) -> PathBuf {
    match store.is_in_place() {
        true => store.folder().join(BACKUP_FILE),
        false => std::env::temp_dir().join(format!("rollout-{}-{BACKUP_FILE}", std::process::id())),
    }
}

/// Removes the half-done copy of a process that was killed.
pub(crate) fn remove_leftover(folder: &Path) {
    // It is not there, as a rule; one that stays is overwritten or reported
    // by the next backup.
    let _ = std::fs::remove_file(folder.join(BACKUP_FILE));
}
