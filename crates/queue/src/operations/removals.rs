//! Removing the files of what was deleted. What stays on the disk is
//! logged, and tried again at the next start.

use std::io::ErrorKind;

use super::context::Context;
use super::shared::Shared;
use crate::store::failpoint::Step;
use crate::store::{StoreError, removals};

/// Removes what a process that died before had still to remove.
pub(crate) async fn finish_all(shared: &Shared) -> Result<(), StoreError> {
    let mut view = shared.store.read().await?;
    let pending = removals::pending(&mut view).await?;
    drop(view);
    for path in pending {
        finish(shared, &path).await?;
    }
    Ok(())
}

/// Removes a folder, or a file, below the data folder.
pub(crate) async fn finish(shared: &Shared, below: &str) -> Result<(), StoreError> {
    let path = shared.store.folder().join(below);
    let removed = match path.is_dir() {
        true => tokio::fs::remove_dir_all(&path).await,
        false => tokio::fs::remove_file(&path).await,
    };
    if let Err(error) = removed
        && error.kind() != ErrorKind::NotFound
    {
        let path = path.display();
        tracing::error!("failed to remove {path}: {error}; the next start tries again");
        return Ok(());
    }
    if let Some(elsewhere) = &shared.elsewhere
        && let Err(problem) = elsewhere.remove(below).await
    {
        tracing::warn!("failed to {problem}; it is tried again");
        return Ok(());
    }
    let mut context = Context::begin(shared, vec![Step::FinishRemoval]).await?;
    removals::done(&mut context.tx, below).await?;
    context.commit().await
}
