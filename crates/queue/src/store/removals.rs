//! Statements on `removal`: folders and files that are to be removed.

use sqlx::SqliteConnection;

use super::{Doing, StoreError};

pub(crate) async fn add(tx: &mut SqliteConnection, folder: &str) -> Result<(), StoreError> {
    sqlx::query("INSERT OR IGNORE INTO removal (folder) VALUES (?)")
        .bind(folder)
        .execute(tx)
        .await
        .doing("mark a folder for removal")
        .map(drop)
}

pub(crate) async fn remove(tx: &mut SqliteConnection, folder: &str) -> Result<(), StoreError> {
    sqlx::query("DELETE FROM removal WHERE folder = ?")
        .bind(folder)
        .execute(tx)
        .await
        .doing("unmark a removed folder")
        .map(drop)
}

pub(crate) async fn pending(tx: &mut SqliteConnection) -> Result<Vec<String>, StoreError> {
    sqlx::query_scalar("SELECT folder FROM removal ORDER BY folder")
        .fetch_all(tx)
        .await
        .doing("list folders to be removed")
}
