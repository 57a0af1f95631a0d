//! Check of an untrusted database's schema.

use std::path::Path;

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection, SqliteConnection};

use super::fresh_database;

/// Compares the schema of an untrusted database with this program's. Returns a description of the
/// first foreign, altered or missing object; `None` if the schemas are equal.
///
/// Reads only the schema table, so that nothing in the database is executed.
pub(crate) async fn foreign_schema(path: &Path) -> Result<Option<String>, sqlx::Error> {
    let options = SqliteConnectOptions::new().filename(path).read_only(true);
    let mut database = options.immutable(true).pragma("trusted_schema", "OFF").connect().await?;
    let found = objects(&mut database).await?;
    database.close().await?;
    let known = objects(&mut fresh_database().await?).await?;
    if known == found {
        return Ok(None);
    }
    let foreign = found.iter().find(|object| !known.contains(object));
    let missing = known.iter().find(|object| !found.contains(object));
    Ok(Some(match (foreign, missing) {
        (Some((kind, name, _)), _) => format!("{kind} {name} is foreign or was altered"),
        (None, Some((kind, name, _))) => format!("{kind} {name} is missing"),
        (None, None) => "an object occurs twice".to_owned(),
    }))
}

/// Returns all named objects of a database with their SQL, in order. This includes SQLite's
/// automatic indices and internal tables, since a manipulated database can hold anything under
/// their names.
async fn objects(
    connection: &mut SqliteConnection,
) -> Result<Vec<(String, String, Option<String>)>, sqlx::Error> {
    sqlx::query_as("SELECT type, name, sql FROM sqlite_schema ORDER BY type, name")
        .fetch_all(connection)
        .await
}
