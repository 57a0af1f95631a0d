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
}

impl Store {
    /// Opens another database file beside this one. Nothing is written to it.
    pub(crate) async fn beside(&self, file: &Path) -> Result<Beside<'_>, StoreError> {
        let connection = self.writer.acquire().await;
        let mut connection = connection.doing("begin a transaction")?;
        // The pool opens another one, which knows nothing of the other database.
        connection.close_on_drop();
        sqlx::query("ATTACH ? AS source")
            .bind(file.display().to_string())
            .execute(&mut *connection)
            .await
            .doing("open the database of an archive")?;
        Ok(Beside {
            connection,
            store: self,
        })
    }
}

impl Beside<'_> {
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
