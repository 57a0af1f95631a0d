//! Background task that moves films from the data folder to the storage given by `--artifacts`. A
//! film that cannot be stored stays in the data folder and is retried.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use futures_util::StreamExt;
use futures_util::stream;
use queue::{FilmRemoval, LocalFilm, Queue};

use crate::storage::{Storage, StorageError};

const SCAN_INTERVAL: Duration = Duration::from_secs(2);
/// Number of concurrent uploads: several, since the storage's latency exceeds the transfer time of
/// a film.
const CONCURRENCY: usize = 8;
/// Longest pause between retries while the storage fails.
const LONGEST_PAUSE: Duration = Duration::from_secs(60);

/// Moves films until the future is dropped.
pub(crate) async fn run(queue: Arc<Queue>, storage: Arc<Storage>) {
    let mut pause = SCAN_INTERVAL;
    loop {
        match move_films(&queue, &storage).await {
            Ok(()) if pause > SCAN_INTERVAL => {
                tracing::info!("films are stored at {} again", storage.location());
                pause = SCAN_INTERVAL;
            }
            Ok(()) => {}
            Err(problem) => {
                // Logged once per outage.
                if pause == SCAN_INTERVAL {
                    tracing::error!(
                        "failed to {problem}; films stay in the data folder and are retried"
                    );
                }
                pause = (pause * 2).min(LONGEST_PAUSE);
            }
        }
        tokio::time::sleep(pause).await;
    }
}

async fn move_films(queue: &Queue, storage: &Storage) -> Result<(), String> {
    let describe = |error: &(dyn std::error::Error + 'static)| transport::chain(error);
    let films = queue.local_films().await.map_err(|error| describe(&error))?;
    // Started transfers run to their end, so that the storage keeps no partial upload; after a
    // failure of the storage no further transfer starts.
    let storage_failed = AtomicBool::new(false);
    let moves = stream::iter(films).map(|film| {
        let storage_failed = &storage_failed;
        async move {
            if storage_failed.load(Ordering::Relaxed) {
                return Ok(());
            }
            let moved = move_film(queue, storage, &film).await;
            // Only a failure of the storage stops the other transfers; a failure of one file does
            // not.
            if let Err(MoveError::Storage(_)) = moved {
                storage_failed.store(true, Ordering::Relaxed);
            }
            moved
        }
    });
    let moved: Vec<Result<(), MoveError>> = moves.buffer_unordered(CONCURRENCY).collect().await;
    let mut failed: Vec<MoveError> = moved.into_iter().filter_map(Result::err).collect();
    if let Some(index) = failed.iter().position(|error| matches!(error, MoveError::Storage(_))) {
        return Err(failed.swap_remove(index).into_message());
    }
    // Retries the removal of deleted campaigns' folders from the storage.
    let removed = queue.finish_removals().await;
    removed.map_err(|error| describe(&error))?;
    failed.pop().map_or(Ok(()), |error| Err(error.into_message()))
}

enum MoveError {
    /// The film's file failed; other films can still be moved.
    File(String),
    /// The storage failed, so no other film can be moved either.
    Storage(String),
}

impl MoveError {
    fn into_message(self) -> String {
        let (Self::File(message) | Self::Storage(message)) = self;
        message
    }

    fn from_storage(error: &StorageError) -> Self {
        let message = transport::chain(error);
        match error {
            StorageError::File { .. } => Self::File(message),
            _ => Self::Storage(message),
        }
    }
}

async fn move_film(queue: &Queue, storage: &Storage, film: &LocalFilm) -> Result<(), MoveError> {
    let stored = storage.put(&film.path, &film.file).await;
    stored.map_err(|error| MoveError::from_storage(&error))?;
    let removal = queue
        .remove_local_film(film)
        .await
        .map_err(|error| MoveError::File(format!("remove {}: {error}", film.file.display())))?;
    if removal == FilmRemoval::CampaignDeleted {
        let deleted = storage.delete(&film.path).await;
        deleted.map_err(|error| MoveError::from_storage(&error))?;
    }
    Ok(())
}
