//! A second database attached to the writer, to copy rows from.

use std::path::Path;

use sqlx::pool::PoolConnection;
use sqlx::{Connection, Sqlite};

use super::failpoint::Step;
use super::{Doing, Store, StoreError, Tx};

/// The writer with another database attached as the schema `source`. Other writing transactions
/// wait until this value is dropped.
pub(crate) struct Attached<'a> {
    connection: PoolConnection<Sqlite>,
    store: &'a Store,
    is_attached: bool,
}

impl Store {
    /// Attaches another database file, to which nothing is written.
    pub(crate) async fn attach(&self, file: &Path) -> Result<Attached<'_>, StoreError> {
        let connection = self.writer.acquire().await;
        let mut attached = Attached {
            connection: connection.doing("begin a transaction")?,
            store: self,
            is_attached: true,
        };
        sqlx::query("ATTACH ? AS source")
            .bind(file.display().to_string())
            .execute(&mut *attached.connection)
            .await
            .doing("open the database of an archive")?;
        Ok(attached)
    }
}

impl Drop for Attached<'_> {
    fn drop(&mut self) {
        if self.is_attached {
            // The pool opens a new connection, without the attached database.
            self.connection.close_on_drop();
        }
    }
}

impl Attached<'_> {
    /// Detaches the other database and returns the writer to the pool with its page cache.
    pub(crate) async fn detach(mut self) -> Result<(), StoreError> {
        let detached = sqlx::query("DETACH source").execute(&mut *self.connection);
        detached.await.doing("close the database of an archive")?;
        self.is_attached = false;
        Ok(())
    }

    /// Begins the writing transaction that carries out `steps`. The transaction is deferred, since
    /// an immediate one would also lock the attached database.
    pub(crate) async fn write(&mut self, steps: Vec<Step>) -> Result<Tx<'_>, StoreError> {
        let transaction = self.connection.begin().await;
        Ok(Tx {
            transaction: transaction.doing("begin a transaction")?,
            steps,
            failpoints: &self.store.failpoints,
        })
    }
}
