//! Hostile calls to the coordinator: every method of both services, on a real queue and database in
//! which worker `w` holds a job of campaign `c`.
//!
//! Checks that a refused call changes neither the database nor the number of artifacts, and that
//! after all calls every invariant of the database holds and the next caller gets an answer. The
//! clock is stopped, so that an input is reproducible.

mod messages;
mod seeds;
mod service;

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use queue::invariants::check;
use queue::{ARTIFACTS_FOLDER, DATABASE_FILE};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection, SqliteConnection};
use tonic::Code;

use crate::untrusted_input::call::{block_on, is_internal_fault};
use crate::untrusted_input::script;
use messages::METHODS;
use service::{TestCoordinator, run_valid};

pub(crate) use seeds::seeds;

/// Bytes of a database with a campaign, a worker and a lease.
static DATABASE: LazyLock<Vec<u8>> = LazyLock::new(|| run_valid(&messages::lease_calls()).0);

/// Makes the calls of an input in order; returns true if none was refused.
pub(crate) fn check_calls(input: &[u8]) -> bool {
    let database = &*DATABASE;
    block_on(async {
        let folder = tempfile::tempdir().expect("a temporary folder");
        std::fs::write(folder.path().join(DATABASE_FILE), database).expect("a file");
        let mut coordinator = TestCoordinator::in_folder(folder.path()).await;
        let mut detector = ChangeDetector::open(folder.path()).await;
        let mut are_all_accepted = true;
        for call in script::read(input) {
            let before = detector.snapshot().await;
            let method = &*METHODS[usize::from(call.method) % METHODS.len()];
            if let Some(Err(refusal)) = coordinator.call(method, &call.messages).await {
                // The coordinator returns Unavailable when its database fails.
                let is_internal_fault =
                    is_internal_fault(&refusal) || refusal.code() == Code::Unavailable;
                assert!(!is_internal_fault, "{method} {call:?}: {refusal}");
                let after = detector.snapshot().await;
                assert_eq!(before, after, "{method} {call:?}: {refusal}");
                are_all_accepted = false;
            }
        }
        detector.0.close().await.expect("closes");
        assert_eq!(check(folder.path()).await.expect("a database"), []);
        let (method, message) = messages::registration("next");
        let next = coordinator.call(method, &[&message]).await;
        next.expect("an answer").expect("a sound message");
        coordinator.close().await;
        are_all_accepted
    })
}

/// Detects changes of a database and of the number of artifacts.
struct ChangeDetector(SqliteConnection, PathBuf);

impl ChangeDetector {
    async fn open(data: &Path) -> ChangeDetector {
        let file = data.join(DATABASE_FILE);
        let options = SqliteConnectOptions::new().filename(file).read_only(true);
        let connection = options.connect().await.expect("a database");
        ChangeDetector(connection, data.join(ARTIFACTS_FOLDER))
    }

    /// Returns a number that changes with every commit of another connection, and the number of
    /// artifacts.
    async fn snapshot(&mut self) -> (i64, usize) {
        let version = sqlx::query_scalar("PRAGMA data_version");
        let version = version.fetch_one(&mut self.0).await.expect("a number");
        (version, files_below(&self.1))
    }
}

fn files_below(folder: &Path) -> usize {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return 0;
    };
    let paths = entries.map(|entry| entry.expect("an entry").path());
    let counts = paths.map(|path| if path.is_dir() { files_below(&path) } else { 1 });
    counts.sum()
}

#[cfg(test)]
mod tests {
    use benchmark::attempt::AttemptId;

    use super::*;

    #[test]
    fn a_release_of_an_unknown_attempt_is_refused_and_changes_nothing() {
        let is_accepted = |attempt_id: String| {
            let (_, release) = messages::release_of(attempt_id);
            check_calls(&script::write(4, &release))
        };
        assert!(is_accepted(messages::attempt()));
        assert!(!is_accepted(AttemptId::from_random([7; 16]).to_string()));
    }
}
