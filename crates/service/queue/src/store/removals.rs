//! Statements on `removal`: folders of deleted campaigns that may still be on
//! the disk.

use sqlx::SqliteConnection;

use super::{Doing, StoreError};

/// Notes that a folder is to be removed.
pub(crate) async fn note(tx: &mut SqliteConnection, folder: &str) -> Result<(), StoreError> {
    sqlx::query("INSERT OR IGNORE INTO removal (folder) VALUES (?)")
        .bind(folder)
        .execute(tx)
        .await
        .doing("note a folder that is to be removed")
        .map(drop)
}

/// Notes that a folder is gone.
pub(crate) async fn done(tx: &mut SqliteConnection, folder: &str) -> Result<(), StoreError> {
    sqlx::query("DELETE FROM removal WHERE folder = ?")
        .bind(folder)
        .execute(tx)
        .await
        .doing("note that a folder was removed")
        .map(drop)
}

/// Folders that are to be removed.
pub(crate) async fn pending(tx: &mut SqliteConnection) -> Result<Vec<String>, StoreError> {
    sqlx::query_scalar("SELECT folder FROM removal ORDER BY folder")
        .fetch_all(tx)
        .await
        .doing("look for folders that are to be removed")
}
