use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use coordinator::{Config, Coordinator};
use queue::clock::{ManualClock, UnixMillis};
use queue::{DATABASE_FILE, Timing};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use tokio::time::timeout;
use tonic::Status;
use tonic::codegen::Bytes;
use tonic::service::Routes;
use transport::Security;

use super::messages::{CLAIM, EncodedCall, SEED, registration};
use crate::untrusted_input::call::{block_on, call};

/// Time that a claim may wait before its caller disconnects.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(20);
const NOW: UnixMillis = UnixMillis(1_700_000_000_000);

pub(super) type Answer = Result<Vec<Bytes>, Status>;

/// A coordinator without a listener; tests call its services directly.
pub(super) struct TestCoordinator {
    coordinator: Coordinator,
    services: Routes,
}

impl TestCoordinator {
    /// Opens a data folder like a starting coordinator. The random seed differs from the seed of
    /// the start that created the database, since attempt ids are never reused.
    pub(super) async fn in_folder(data: &Path) -> TestCoordinator {
        let starts = u64::from(data.join(DATABASE_FILE).exists());
        let coordinator = Coordinator::open(Config {
            data: data.to_owned(),
            timing: Timing::default(),
            clock: Arc::new(ManualClock::at(NOW)),
            rng: ChaCha8Rng::seed_from_u64(SEED + starts),
            security: Security::loopback(),
            min_free_bytes: 0,
            storage: None,
        });
        let coordinator = coordinator.await.expect("a coordinator");
        TestCoordinator { services: coordinator.services(), coordinator }
    }

    /// Calls a method; returns `None` if the call waits for a job.
    pub(super) async fn call(&mut self, method: &str, messages: &[&[u8]]) -> Option<Answer> {
        let answering = self.call_to_end(method, messages);
        if method != CLAIM {
            return Some(answering.await);
        }
        let answer = timeout(ANSWER_TIMEOUT, answering).await.ok();
        if answer.is_none() {
            // The abandoned claim may still be committed. A registration waits for that commit, so
            // that its effect is not attributed to the input's next call.
            let (method, message) = registration("next");
            let registered = self.call_to_end(method, &[&message]).await;
            registered.expect("a valid message");
        }
        answer
    }

    async fn call_to_end(&mut self, method: &str, messages: &[&[u8]]) -> Answer {
        let path = format!("/rollout.coordinator.v1.{method}");
        call(&mut self.services, &path, messages).await
    }

    pub(super) async fn close(self) {
        self.coordinator.queue().close().await.expect("closes");
    }
}

/// Makes valid calls on a new coordinator; returns its database file and the last call's answer.
pub(super) fn run_valid(calls: &[EncodedCall]) -> (Vec<u8>, Vec<Bytes>) {
    block_on(async {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut coordinator = TestCoordinator::in_folder(folder.path()).await;
        let mut last = Vec::new();
        for (method, message) in calls {
            let answer = coordinator.call_to_end(method, &[message]).await;
            last = answer.expect("a valid message");
        }
        coordinator.close().await;
        let database = std::fs::read(folder.path().join(DATABASE_FILE));
        (database.expect("a database"), last)
    })
}
