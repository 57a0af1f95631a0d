//! Detection of commits, and sizes of the database files.

use sqlx::Sqlite;
use sqlx::pool::PoolConnection;

use crate::store::{DATABASE_FILE, Doing, Store, StoreError};

/// Detects commits of other connections, on a connection of its own.
#[derive(Debug)]
pub struct Changes(PoolConnection<Sqlite>);

/// Sizes of the database's files, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// Main database file.
    pub database: u64,
    pub log: u64,
}

impl Changes {
    pub(crate) async fn begin(store: &Store) -> Result<Changes, StoreError> {
        store.reader().await.map(Changes)
    }

    /// Returns a number that changes with every commit of another connection.
    pub async fn version(&mut self) -> Result<i64, StoreError> {
        sqlx::query_scalar("PRAGMA data_version")
            .fetch_one(&mut *self.0)
            .await
            .doing("watch for changes")
    }
}

impl Store {
    /// Returns the sizes of the database files; a missing file counts as 0.
    pub fn sizes(&self) -> Sizes {
        let size = |name: &str| std::fs::metadata(self.folder().join(name)).map_or(0, |m| m.len());
        Sizes { database: size(DATABASE_FILE), log: size(&format!("{DATABASE_FILE}-wal")) }
    }
}
