//! The SQLite database: opening, locking, migrating and closing it, and its transactions.
//! Submodules hold the SQL statements and the conversions of their rows; decisions are made by
//! [`rules`](crate::rules).
//!
//! One coordinator owns a data folder: one connection writes, several read, in WAL mode with
//! `synchronous=FULL`, so that a committed transaction survives a power cut.

pub(crate) mod artifacts;
pub(crate) mod backup;
pub(crate) mod budgets;
pub(crate) mod campaigns;
pub(crate) mod claims;
pub(crate) mod failpoint;
pub(crate) mod films;
pub(crate) mod hidden;
pub(crate) mod instants;
pub(crate) mod jobs;
pub(crate) mod outcomes;
pub(crate) mod policies;
pub(crate) mod portable;
pub(crate) mod provenance;
pub(crate) mod removals;
pub(crate) mod results;
pub(crate) mod stops;
pub(crate) mod workers;

use std::fs::{DirBuilder, File, Permissions, TryLockError};
use std::io;
use std::ops::{Deref, DerefMut};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use sqlx::migrate::{MigrateError, Migrator};
use sqlx::pool::PoolConnection;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{Connection, Sqlite, SqliteConnection, Transaction};

use failpoint::{Failpoints, Side, Step};

pub const DATABASE_FILE: &str = "coordinator.sqlite";
/// Permissions of a data folder and of its database: outcomes, videos and addresses of policies are
/// private. Other users of the machine go through the coordinator.
const PRIVATE_FOLDER_MODE: u32 = 0o700;
const PRIVATE_MODE: u32 = 0o600;
/// Number of read-only connections beside the writer. Large reads take at most seven: two answers
/// to operators, two statistics and two comparisons of pages, and early stops. The others serve
/// small queries.
const READERS: u32 = 10;
/// Longest wait of a statement for a lock held by another process, such as a backup or an
/// interactive shell.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// Longest wait for readers when the store is closed.
const READERS_GRACE: Duration = Duration::from_secs(2);

static MIGRATIONS: Migrator = sqlx_macros::migrate!("../../migrations");

/// The open database of one data folder.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
    writer: SqlitePool,
    readers: SqlitePool,
    /// Device and inode of the database file at opening.
    file: (u64, u64),
    failpoints: Failpoints,
    /// The locked data folder, which this process owns until the store is closed. The kernel
    /// releases the lock however the process ends, and no removed file undoes it.
    lock: File,
}

#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    #[error("open data folder {}: check that it exists and that this user may write to it", folder.display())]
    Folder { folder: PathBuf, source: io::Error },
    #[error("open data folder {}: another coordinator is using it; stop that one, or choose another folder with --data", folder.display())]
    InUse { folder: PathBuf },
    #[error(
        "open database {}: its schema is version {found} and this program ({program}) supports versions up to {known}; run the newer program that wrote it, or choose another folder with --data",
        path.display()
    )]
    NewerSchema { path: PathBuf, found: i64, known: i64, program: &'static str },
    #[error(
        "open database {}: an older checkout of this program made it, and its schema cannot be converted; start with an empty folder with --data, and keep the older checkout to read this one",
        path.display()
    )]
    OlderCheckout { path: PathBuf },
    #[error("bring database {} to schema version {known}: make room on its disk, restore it from a backup, or choose another folder with --data", path.display())]
    Migrate { path: PathBuf, known: i64, source: MigrateError },
    #[error(
        "open database {}: check that it is a SQLite file on a local disk, or restore it from a \
         backup",
        path.display()
    )]
    Database { path: PathBuf, source: sqlx::Error },
}

#[derive(Clone, Debug, thiserror::Error)]
pub enum StoreError {
    #[error(
        "{doing} in the database: the disk of the coordinator's data folder is full; make room there"
    )]
    Full { doing: &'static str },
    #[error("{doing} in the database")]
    Statement { doing: &'static str, source: Arc<sqlx::Error> },
    /// The database file was removed or replaced. SQLite continues with the open file, whose
    /// contents are lost when this process ends.
    #[error(
        "write to the database: the data folder {} is gone, or another database is in its \
         place. Nothing more can be stored; while this coordinator runs, \
         `coordinator backup --output FILE` saves what was committed",
        folder.display()
    )]
    Gone { folder: PathBuf },
}

impl StoreError {
    /// Returns true if a stored value could not be decoded, so that a retry would also fail.
    pub(crate) fn is_undecodable(&self) -> bool {
        let Self::Statement { source, .. } = self else {
            return false;
        };
        matches!(**source, sqlx::Error::Decode(_) | sqlx::Error::ColumnDecode { .. })
    }

    pub(crate) fn with_cause(&self) -> String {
        match self {
            Self::Statement { source, .. } => format!("{self}: {source}"),
            _ => self.to_string(),
        }
    }
}

/// The writing transaction, of which there is one at a time. Rolled back on drop.
#[derive(Debug)]
pub(crate) struct Tx<'a> {
    transaction: Transaction<'a, Sqlite>,
    /// Steps carried out by the transaction, for failpoints.
    steps: Vec<Step>,
    failpoints: &'a Failpoints,
}

/// SQLite's code for a full disk.
const SQLITE_FULL: &str = "13";

/// Adds the purpose of a statement to its error.
pub(crate) trait Doing<T> {
    fn doing(self, doing: &'static str) -> Result<T, StoreError>;
}

impl<T> Doing<T> for Result<T, sqlx::Error> {
    fn doing(self, doing: &'static str) -> Result<T, StoreError> {
        self.map_err(|source| {
            let code = source.as_database_error().and_then(|error| error.code());
            match code.as_deref() == Some(SQLITE_FULL) {
                true => StoreError::Full { doing },
                false => StoreError::Statement { doing, source: Arc::new(source) },
            }
        })
    }
}

/// Returns the options of a pool whose connections stay open until it is closed.
///
/// With a lifetime or an idle timeout, sqlx 0.9 starts a task that counts idle connections. Its
/// counter can fall below zero while a connection is released, and then the task loops for ever
/// and the runtime never ends.
fn pool_options(connections: u32) -> SqlitePoolOptions {
    SqlitePoolOptions::new().max_connections(connections).max_lifetime(None).idle_timeout(None)
}

pub(crate) fn undecodable(
    error: impl Into<Box<dyn std::error::Error + Send + Sync>>,
) -> sqlx::Error {
    sqlx::Error::Decode(error.into())
}

/// Log size, in pages, at which a commit also checkpoints the log while the next writing
/// transaction waits: 64 MiB. [`Store::checkpoint`] normally runs earlier.
const LARGEST_LOG_PAGES: &str = "16384";
/// Page cache of the writer, KiB, negative as SQLite's `cache_size` expects it.
const WRITER_CACHE_KIB: &str = "-65536";
/// Batch sizes of INSERT statements: only a few, so that each statement stays prepared.
const INSERTED_ROWS: [usize; 4] = [64, 16, 4, 1];

/// Splits rows into batches whose sizes are those of [`INSERTED_ROWS`].
pub(crate) fn insert_batches<T>(mut rows: &[T]) -> impl Iterator<Item = &[T]> {
    std::iter::from_fn(move || {
        let size = INSERTED_ROWS.into_iter().find(|size| *size <= rows.len())?;
        let (batch, remaining) = rows.split_at(size);
        rows = remaining;
        Some(batch)
    })
}

/// Serialises values for one statement that reads them with `json_each`.
pub(crate) fn json(values: impl serde::Serialize) -> String {
    serde_json::to_string(&values).expect("numbers and text are JSON")
}

impl Store {
    /// Opens the database of a data folder, creating or migrating it as needed. A database that
    /// another program wrote is left untouched.
    pub async fn open(folder: &Path) -> Result<Store, OpenError> {
        let in_folder = |source| OpenError::Folder { folder: folder.to_owned(), source };
        let path = folder.join(DATABASE_FILE);
        if path.exists() {
            refuse_other_schema(&path).await?;
        }
        let mut builder = DirBuilder::new();
        builder.recursive(true).mode(PRIVATE_FOLDER_MODE);
        builder.create(folder).map_err(in_folder)?;
        let lock = lock_folder(folder)?;
        make_private(&path).map_err(in_folder)?;
        let options = SqliteConnectOptions::new()
            .filename(&path)
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .foreign_keys(true)
            .busy_timeout(BUSY_TIMEOUT);
        let database = |source| OpenError::Database { path: path.clone(), source };
        let writer = pool_options(1)
            // SQLite rolls back by itself when the disk is full, but the connection would still
            // count its transaction as open.
            .before_acquire(|connection, _| {
                let is_usable = !connection.is_in_transaction();
                Box::pin(async move { Ok(is_usable) })
            })
            .connect_with(
                options
                    .clone()
                    .pragma("wal_autocheckpoint", LARGEST_LOG_PAGES)
                    .pragma("cache_size", WRITER_CACHE_KIB),
            )
            .await
            .map_err(database)?;
        MIGRATIONS.run(&writer).await.map_err(|source| OpenError::Migrate {
            path: path.clone(),
            known: newest_known_schema(),
            source,
        })?;
        let readers = pool_options(READERS)
            .connect_with(options.create_if_missing(false))
            .await
            .map_err(database)?;
        Ok(Store {
            file: identity(&path).map_err(in_folder)?,
            folder: folder.to_owned(),
            writer,
            readers,
            failpoints: Failpoints::from_environment(),
            lock,
        })
    }

    /// Sets the writer's lock timeout, instead of [`BUSY_TIMEOUT`].
    #[cfg(test)]
    pub(crate) async fn set_lock_timeout(&self, timeout: Duration) {
        let pragma = format!("PRAGMA busy_timeout = {}", timeout.as_millis());
        sqlx::raw_sql(sqlx::AssertSqlSafe(pragma)).execute(&self.writer).await.expect("a pragma");
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Waits until the preceding writing transaction has ended, and begins the one that carries out
    /// `steps`. Fails if the database's file is no longer in the data folder: data written to the
    /// open file would be lost when this process ends.
    pub(crate) async fn write(&self, steps: Vec<Step>) -> Result<Tx<'_>, StoreError> {
        if !self.is_in_place() {
            let folder = self.folder.clone();
            return Err(StoreError::Gone { folder });
        }
        let transaction = self.writer.begin_with("BEGIN IMMEDIATE").await;
        Ok(Tx {
            transaction: transaction.doing("begin a transaction")?,
            steps,
            failpoints: &self.failpoints,
        })
    }

    /// Returns true if the data folder still has the file that was opened.
    pub(crate) fn is_in_place(&self) -> bool {
        let current = identity(&self.folder.join(DATABASE_FILE));
        current.is_ok_and(|current| current == self.file)
    }

    /// Begins a read transaction, to which commits after this instant are invisible.
    pub(crate) async fn read(&self) -> Result<Transaction<'static, Sqlite>, StoreError> {
        self.readers.begin().await.doing("begin reading")
    }

    /// Returns a read connection outside a transaction, which sees new commits.
    pub(crate) async fn reader(&self) -> Result<PoolConnection<Sqlite>, StoreError> {
        self.readers.acquire().await.doing("begin reading")
    }

    /// Checkpoints the write-ahead log into the database, as far as no reader needs it, without
    /// stopping the writer.
    pub(crate) async fn checkpoint(&self) -> Result<(), StoreError> {
        sqlx::query("PRAGMA wal_checkpoint(PASSIVE)")
            .execute(&self.readers)
            .await
            .doing("checkpoint the write-ahead log")
            .map(drop)
    }

    /// Checkpoints the entire write-ahead log, closes the database and unlocks the data folder. If
    /// the log cannot be checkpointed, nothing is lost, since the next start reads it.
    pub async fn close(&self) -> Result<(), StoreError> {
        // A slow reader must not keep the coordinator from shutting down.
        let _ = tokio::time::timeout(READERS_GRACE, self.readers.close()).await;
        sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)")
            .execute(&self.writer)
            .await
            .doing("checkpoint the write-ahead log")?;
        self.writer.close().await;
        // Tasks that are shutting down may still hold the store.
        let unlocked = self.lock.unlock().map_err(sqlx::Error::Io);
        unlocked.doing("unlock the data folder")
    }
}

/// Returns the newest schema version that this program supports.
pub fn newest_known_schema() -> i64 {
    MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0)
}

impl Tx<'_> {
    pub(crate) async fn commit(self) -> Result<(), StoreError> {
        for step in &self.steps {
            self.failpoints.reach(Side::Before, *step);
        }
        let committed = self.transaction.commit().await;
        committed.doing("commit a transaction")?;
        for step in &self.steps {
            self.failpoints.reach(Side::After, *step);
        }
        Ok(())
    }
}

impl Deref for Tx<'_> {
    type Target = SqliteConnection;

    fn deref(&self) -> &SqliteConnection {
        &self.transaction
    }
}

impl DerefMut for Tx<'_> {
    fn deref_mut(&mut self) -> &mut SqliteConnection {
        &mut self.transaction
    }
}

/// Returns device and inode of a file.
fn identity(path: &Path) -> io::Result<(u64, u64)> {
    let metadata = std::fs::metadata(path)?;
    Ok((metadata.dev(), metadata.ino()))
}

fn lock_folder(folder: &Path) -> Result<File, OpenError> {
    let in_folder = |source| OpenError::Folder { folder: folder.to_owned(), source };
    let lock = File::open(folder).map_err(in_folder)?;
    match lock.try_lock() {
        Ok(()) => Ok(lock),
        Err(TryLockError::WouldBlock) => Err(OpenError::InUse { folder: folder.to_owned() }),
        Err(TryLockError::Error(source)) => Err(in_folder(source)),
    }
}

/// Restricts a database to its owner, creating the file if needed, since SQLite would create it
/// readable by everybody. Files that SQLite creates beside the database inherit its permissions.
fn make_private(database: &Path) -> io::Result<()> {
    // Fails without write access, which SQLite reports only at the first write.
    File::options().create(true).append(true).mode(PRIVATE_MODE).open(database)?;
    for suffix in ["", "-wal", "-shm"] {
        let mut path = database.as_os_str().to_owned();
        path.push(suffix);
        let path = Path::new(&path);
        let Ok(found) = path.metadata() else { continue };
        let mode = found.mode() & 0o777;
        if mode & !PRIVATE_MODE != 0 {
            // Fails harmlessly for a file that another user owns.
            let private = Permissions::from_mode(mode & PRIVATE_MODE);
            let _ = std::fs::set_permissions(path, private);
        }
    }
    Ok(())
}

/// Refuses an existing database whose migrations are not this program's, or go beyond them, without
/// writing to it.
async fn refuse_other_schema(path: &Path) -> Result<(), OpenError> {
    let database = |source| OpenError::Database { path: path.to_owned(), source };
    let options = SqliteConnectOptions::new().filename(path).read_only(true);
    let mut connection = SqliteConnection::connect_with(&options).await.map_err(database)?;
    let applied = applied_migrations(&mut connection).await.map_err(database)?;
    connection.close().await.map_err(database)?;
    let is_ours = applied.iter().zip(MIGRATIONS.iter()).all(|((version, checksum), ours)| {
        *version == ours.version && checksum[..] == ours.checksum[..]
    });
    let known = newest_known_schema();
    match applied.last() {
        Some(_) if !is_ours => Err(OpenError::OlderCheckout { path: path.to_owned() }),
        Some((found, _)) if *found > known => Err(OpenError::NewerSchema {
            path: path.to_owned(),
            found: *found,
            known,
            program: concat!("coordinator ", env!("CARGO_PKG_VERSION")),
        }),
        _ => Ok(()),
    }
}

pub(crate) async fn applied_migrations(
    connection: &mut SqliteConnection,
) -> Result<Vec<(i64, Vec<u8>)>, sqlx::Error> {
    let has_migrations: bool = sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM sqlite_master WHERE name = '_sqlx_migrations')",
    )
    .fetch_one(&mut *connection)
    .await?;
    if !has_migrations {
        return Ok(Vec::new());
    }
    sqlx::query_as("SELECT version, checksum FROM _sqlx_migrations ORDER BY version")
        .fetch_all(connection)
        .await
}

async fn fresh_database() -> Result<SqliteConnection, sqlx::Error> {
    let mut fresh = SqliteConnection::connect("sqlite::memory:").await?;
    let migrated = MIGRATIONS.run_direct(None, &mut fresh, false).await;
    migrated.map_err(|error| sqlx::Error::Migrate(Box::new(error)))?;
    Ok(fresh)
}

/// Creates the temporary table `known_schema` with this program's schema in the open database.
pub(crate) async fn load_schema(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    let mut fresh = fresh_database().await?;
    let objects: Vec<(String, String, Option<String>)> =
        sqlx::query_as("SELECT type, name, sql FROM sqlite_schema").fetch_all(&mut fresh).await?;
    sqlx::query("CREATE TEMP TABLE known_schema (type TEXT, name TEXT, sql TEXT)")
        .execute(&mut *connection)
        .await?;
    for (kind, name, sql) in objects {
        sqlx::query("INSERT INTO temp.known_schema VALUES (?, ?, ?)")
            .bind(kind)
            .bind(name)
            .bind(sql)
            .execute(&mut *connection)
            .await?;
    }
    Ok(())
}
