//! Removal of files of deleted campaigns. A failed removal is logged and retried: continuously if
//! there is remote storage, otherwise at the next start.

use std::io::ErrorKind;

use super::context::Context;
use super::shared::Shared;
use crate::store::failpoint::Step;
use crate::store::{StoreError, removals};

pub(crate) async fn pending(shared: &Shared) -> Result<Vec<String>, StoreError> {
    let mut view = shared.store.read().await?;
    removals::pending(&mut view).await
}

/// Removes a folder or file below the data folder. If there is remote storage, the path stays
/// marked for removal from it.
pub(crate) async fn remove_locally(shared: &Shared, relative: &str) -> Result<(), StoreError> {
    match try_remove_locally(shared, relative).await && shared.remote_storage.is_none() {
        true => unmark(shared, relative).await,
        false => Ok(()),
    }
}

/// Removes a folder or file below the data folder and from remote storage.
pub(crate) async fn remove(shared: &Shared, relative: &str) -> Result<(), StoreError> {
    if !try_remove_locally(shared, relative).await {
        return Ok(());
    }
    if let Some(remote_storage) = &shared.remote_storage
        && let Err(problem) = remote_storage.remove(relative).await
    {
        tracing::warn!("failed to {problem}; the removal is tried again");
        return Ok(());
    }
    unmark(shared, relative).await
}

async fn try_remove_locally(shared: &Shared, relative: &str) -> bool {
    let path = shared.store.folder().join(relative);
    let removed = match path.is_dir() {
        true => tokio::fs::remove_dir_all(&path).await,
        false => tokio::fs::remove_file(&path).await,
    };
    match removed {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            let path = path.display();
            tracing::error!("failed to remove {path}: {error}; the removal is tried again");
            false
        }
        _ => true,
    }
}

async fn unmark(shared: &Shared, relative: &str) -> Result<(), StoreError> {
    let mut context = Context::begin(shared, vec![Step::FinishRemoval]).await?;
    removals::remove(&mut context.tx, relative).await?;
    context.commit().await
}

#[cfg(test)]
mod tests {
    use std::pin::Pin;
    use std::sync::Arc;
    use std::time::Duration;

    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use serde_json::json;
    use tokio::sync::Semaphore;

    use super::*;
    use crate::clock::SystemClock;
    use crate::expand::NewCampaign;
    use crate::ids::CampaignName;
    use crate::operations::alter::Alteration;
    use crate::queue::Queue;
    use crate::remote_storage::RemoteStorage;
    use crate::store::Store;
    use crate::timing::Timing;

    /// Remote storage that answers only when a permit is given.
    struct SlowStorage {
        requests: Semaphore,
        answers: Semaphore,
    }

    impl RemoteStorage for SlowStorage {
        fn remove<'a>(
            &'a self,
            folder: &'a str,
        ) -> Pin<Box<dyn Future<Output = Result<(), String>> + Send + 'a>> {
            Box::pin(async move {
                assert_eq!(
                    folder, "artifacts/one",
                    "only the deleted campaign's folder is removed"
                );
                self.requests.add_permits(1);
                let answer = self.answers.acquire().await;
                answer.map(|answer| answer.forget()).map_err(|_| String::new())
            })
        }
    }

    /// Regression: a deleted campaign whose videos were in unavailable storage blocked the
    /// creation, alteration and deletion of all other campaigns.
    #[tokio::test(flavor = "multi_thread")]
    async fn unresponsive_storage_blocks_no_creation_or_deletion_of_campaigns() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = Store::open(folder.path()).await.expect("a store");
        let (clock, rng) = (Arc::new(SystemClock::start()), ChaCha8Rng::seed_from_u64(1));
        let slow =
            Arc::new(SlowStorage { requests: Semaphore::new(0), answers: Semaphore::new(0) });
        let remote_storage = Some(slow.clone() as Arc<dyn RemoteStorage>);
        let queue = Queue::start_with(store, clock, rng, Timing::default(), remote_storage).await;
        let queue = queue.expect("a queue");
        let name = |name: &str| CampaignName::parse(name).expect("a name");
        let create = async |name: &str| {
            let spec = json!({
                "name": name,
                "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
                "tasks": ["object/0"], "axes": ["camera"], "levels": ["L1"], "configs": [0],
            });
            let campaign = NewCampaign::from_json(&spec.to_string()).expect("a campaign");
            queue.create_campaign(&campaign).await.expect("created");
        };
        create("one").await;
        let archive = tempfile::tempdir().expect("a temporary folder");
        let (copy, _) = queue.copy_campaign(&name("one"), archive.path()).await.expect("copied");
        let mut removing = tokio::task::JoinSet::new();
        let busy = async {
            queue.delete_campaign(&name("one")).await.expect("deleted");
            removing.spawn({
                let queue = queue.clone();
                async move { queue.finish_removals().await.expect("removed") }
            });
            slow.requests.acquire().await.expect("a removal").forget();
            // A new campaign of the same name, whose videos must not be removed together with those
            // of the deleted campaign.
            create("one").await;
            create("two").await;
            let alteration = Alteration { priority: Some(1), ..Alteration::default() };
            queue.alter_campaign(&name("two"), &alteration).await.expect("altered");
            queue.delete_campaign(&name("two")).await.expect("deleted");
            let (imported, _) =
                queue.adopt(&copy, None, Some(&name("three"))).await.expect("imported");
            assert_eq!(imported, name("three"));
        };
        let busy = tokio::time::timeout(Duration::from_secs(30), busy).await;
        busy.expect("no operation waits for the storage");
        let remaining = pending(&queue.shared).await.expect("folders");
        assert_eq!(remaining, ["artifacts/one", "artifacts/two"]);
        slow.answers.add_permits(1);
        removing.join_all().await;
        let remaining = pending(&queue.shared).await.expect("folders");
        assert_eq!(remaining, ["artifacts/two"]);
        let mut view = queue.store().read().await.expect("a view");
        let one = crate::store::campaigns::by_name(&mut view, &name("one")).await;
        assert_eq!(one.expect("a database").expect("the campaign").folder, "one~2");
    }
}
