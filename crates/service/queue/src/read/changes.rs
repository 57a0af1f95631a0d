//! When something was committed, and how large the database is.

use sqlx::Sqlite;
use sqlx::pool::PoolConnection;

use crate::store::{DATABASE_FILE, Doing, Store, StoreError};

/// Tells when something was committed, from a connection of its own.
#[derive(Debug)]
pub struct Changes(PoolConnection<Sqlite>);

/// Sizes of the database's files, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// The database itself.
    pub database: u64,
    /// Its write-ahead log.
    pub log: u64,
}

impl Changes {
    pub(crate) async fn begin(store: &Store) -> Result<Changes, StoreError> {
        store.reader().await.map(Changes)
    }

    /// A number that another connection's commit changes.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn version(&mut self) -> Result<i64, StoreError> {
        sqlx::query_scalar("PRAGMA data_version")
            .fetch_one(&mut *self.0)
            .await
            .doing("watch for changes")
    }
}

impl Store {
    /// Sizes of the database's files; one that is missing has none.
    pub fn sizes(&self) -> Sizes {
        let size = |name: &str| std::fs::metadata(self.folder().join(name)).map_or(0, |m| m.len());
        Sizes {
            database: size(DATABASE_FILE),
            log: size(&format!("{DATABASE_FILE}-wal")),
        }
    }
}
