//! What strangers send the coordinator: every method of both services, on a real
//! queue with a real database, in which worker `w` holds a job of campaign `c`.
//!
//! Held here: a call that is refused has changed nothing, neither the database
//! nor a file; whatever was called, every invariant of the database holds, and
//! the next caller is answered. A clock that stands still makes an input do the
//! same each time.

mod methods;
mod seeds;

use std::path::Path;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

use coordinator::{Config, Coordinator};
use queue::ARTIFACTS_FOLDER;
use queue::DATABASE_FILE;
use queue::Timing;
use queue::clock::{ManualClock, UnixMillis};
use queue::invariants::check;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection, SqliteConnection};
use tokio::time::timeout;
use tonic::codegen::Bytes;
use tonic::service::Routes;
use tonic::{Code, Status};
use transport::Security;

use crate::call::{blames_itself, block_on, call};
use crate::script;
use methods::{CLAIM, METHODS};

pub(crate) use seeds::seeds;

/// How long a claim's caller waits before it hangs up.
const PATIENCE: Duration = Duration::from_millis(20);
/// What a clock that stands still shows.
const NOW: UnixMillis = UnixMillis(1_700_000_000_000);

/// What a service answers: its messages, or that it refuses.
type Answer = Result<Vec<Bytes>, Status>;

/// A database with a campaign, a worker and a lease in it, as a file.
static DATABASE: LazyLock<Vec<u8>> = LazyLock::new(|| after(&seeds::a_lease()).0);

/// The database after sound calls, and the answer to the last of them.
fn after(calls: &[seeds::Said]) -> (Vec<u8>, Vec<Bytes>) {
    block_on(async {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut open = Open::in_folder(folder.path()).await;
        let mut last = Vec::new();
        for (method, message) in calls {
            let answer = open.call(method, &[message]).await;
            last = answer.expect("an answer").expect("a sound message");
        }
        open.close().await;
        let database = std::fs::read(folder.path().join(DATABASE_FILE));
        (database.expect("a database"), last)
    })
}

/// Makes the calls of an input, one after another; says whether none was refused.
///
/// # Panics
/// If what this module holds does not.
pub(crate) fn messages(input: &[u8]) -> bool {
    let database = &*DATABASE;
    block_on(async {
        let folder = tempfile::tempdir().expect("a temporary folder");
        std::fs::write(folder.path().join(DATABASE_FILE), database).expect("a file");
        let mut open = Open::in_folder(folder.path()).await;
        let mut witness = Witness::of(folder.path()).await;
        let mut all_accepted = true;
        for called in script::read(input) {
            let before = witness.look().await;
            let method = METHODS[usize::from(called.method) % METHODS.len()];
            if let Some(Err(refusal)) = open.call(method, &called.messages).await {
                // Unavailable is what it says when its database fails.
                let blames_itself = blames_itself(&refusal) || refusal.code() == Code::Unavailable;
                assert!(!blames_itself, "{method} {called:?}: {refusal}");
                let after = witness.look().await;
                assert_eq!(before, after, "{method} {called:?}: {refusal}");
                all_accepted = false;
            }
        }
        witness.0.close().await.expect("closes");
        assert_eq!(check(folder.path()).await.expect("a database"), []);
        let (method, message) = seeds::registration("next");
        let next = open.call(method, &[&message]).await;
        next.expect("an answer").expect("a sound message");
        open.close().await;
        all_accepted
    })
}

/// A coordinator without a listener; tests call its services directly.
struct Open {
    coordinator: Coordinator,
    services: Routes,
}

impl Open {
    async fn in_folder(data: &Path) -> Open {
        let coordinator = Coordinator::open(Config {
            data: data.to_owned(),
            timing: Timing::default(),
            clock: Arc::new(ManualClock::at(NOW)),
            rng: ChaCha8Rng::seed_from_u64(seeds::SEED),
            security: Security::loopback(),
            min_free_bytes: 0,
            storage: None,
        });
        let coordinator = coordinator.await.expect("a coordinator");
        Open {
            services: coordinator.services(),
            coordinator,
        }
    }

    /// Calls a method; no answer if it waits for a job.
    async fn call(&mut self, method: &str, messages: &[&[u8]]) -> Option<Answer> {
        let path = format!("/rollout.coordinator.v1.{method}");
        let answering = call(&mut self.services, &path, messages);
        if method != CLAIM {
            return Some(answering.await);
        }
        let answer = timeout(PATIENCE, answering).await.ok();
        if answer.is_none() {
            // The call that was given up may still be committed. The next call waits
            // for it, so that its effect is not attributed to that one.
            let (method, message) = seeds::registration("next");
            let path = format!("/rollout.coordinator.v1.{method}");
            let after = call(&mut self.services, &path, &[&message]).await;
            after.expect("a sound message");
        }
        answer
    }

    async fn close(self) {
        self.coordinator.queue().close().await.expect("closes");
    }
}

/// Detects changes of a database and of the files beside it.
struct Witness(SqliteConnection, std::path::PathBuf);

impl Witness {
    async fn of(data: &Path) -> Witness {
        let file = data.join(DATABASE_FILE);
        let options = SqliteConnectOptions::new().filename(file).read_only(true);
        let connection = options.connect().await.expect("a database");
        Witness(connection, data.join(ARTIFACTS_FOLDER))
    }

    /// A number that changes with every writing transaction of another connection,
    /// and how many files there are.
    async fn look(&mut self) -> (i64, usize) {
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
    use super::*;

    #[test]
    fn a_release_of_no_job_is_refused_and_changes_nothing() {
        // Worker w releases attempt 1 of job 0.
        let release = b"\x0a\x05\x0a\x01w\x18\x01\x10\x02\x1a\x01e";
        assert!(!messages(&script::write(4, release)));
    }

    #[test]
    fn every_method_of_both_services_is_called() {
        let proto = include_str!("../../../proto/rollout/coordinator/v1/coordinator.proto");
        let names = METHODS.map(|method| method.split('/').nth(1).expect("a name"));
        for line in proto
            .lines()
            .filter_map(|line| line.trim().strip_prefix("rpc "))
        {
            let name = line.split('(').next().expect("a name");
            assert!(names.contains(&name), "{name}");
        }
    }
}
