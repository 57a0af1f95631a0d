//! Another database beside the writer's own, to copy rows from.

use std::path::Path;

use sqlx::pool::PoolConnection;
use sqlx::{Connection, Sqlite};

use super::failpoint::Step;
use super::{Doing, Store, StoreError, Tx};

/// The writer with another database beside it, as the schema `source`. Whoever wants
/// to write waits until it is dropped.
pub(crate) struct Beside<'a> {
    connection: PoolConnection<Sqlite>,
    store: &'a Store,
    is_attached: bool,
}

impl Store {
    /// Opens another database file beside this one. Nothing is written to it.
    pub(crate) async fn beside(&self, file: &Path) -> Result<Beside<'_>, StoreError> {
        let connection = self.writer.acquire().await;
        let mut beside = Beside {
            connection: connection.doing("begin a transaction")?,
            store: self,
            is_attached: true,
        };
        sqlx::query("ATTACH ? AS source")
            .bind(file.display().to_string())
            .execute(&mut *beside.connection)
            .await
            .doing("open the database of an archive")?;
        Ok(beside)
    }
}

impl Drop for Beside<'_> {
    fn drop(&mut self) {
        if self.is_attached {
            // The pool opens another one, which knows nothing of the other database.
            self.connection.close_on_drop();
        }
    }
}

impl Beside<'_> {
    /// Lets the other database go and gives the writer back with what it has in memory.
    pub(crate) async fn detach(mut self) -> Result<(), StoreError> {
        let detached = sqlx::query("DETACH source").execute(&mut *self.connection);
        detached.await.doing("close the database of an archive")?;
        self.is_attached = false;
        Ok(())
    }

    /// Begins the writing transaction, for these steps. Not an immediate one: that
    /// would lock the other database too, which may be in use.
    pub(crate) async fn write(&mut self, steps: Vec<Step>) -> Result<Tx<'_>, StoreError> {
        let transaction = self.connection.begin().await;
        Ok(Tx {
            transaction: transaction.doing("begin a transaction")?,
            steps,
            failpoints: &self.store.failpoints,
        })
    }
}
