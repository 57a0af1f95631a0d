//! Moves films from the data folder to the storage that an operator chose, as it has
//! time: what cannot be stored stays where it is, and is tried again.

use std::sync::Arc;
use std::time::Duration;

use queue::{Forgotten, Queue};

use crate::storage::{Storage, StorageError};

/// Between two looks for films.
const PAUSE: Duration = Duration::from_secs(2);
/// Longest pause while the storage fails.
const LONGEST_PAUSE: Duration = Duration::from_secs(60);

/// Moves films until it is dropped.
pub(crate) async fn run(queue: Arc<Queue>, storage: Arc<Storage>) {
    let mut pause = PAUSE;
    loop {
        match look(&queue, &storage).await {
            Ok(()) if pause > PAUSE => {
                tracing::info!("films are stored at {} again", storage.location());
                pause = PAUSE;
            }
            Ok(()) => {}
            Err(problem) => {
                // Once for each outage.
                if pause == PAUSE {
                    tracing::error!(
                        "failed to {problem}; films stay in the data folder until then"
                    );
                }
                pause = (pause * 2).min(LONGEST_PAUSE);
            }
        }
        tokio::time::sleep(pause).await;
    }
}

/// Moves what is there now.
async fn look(queue: &Queue, storage: &Storage) -> Result<(), String> {
    let in_words = |error: &(dyn std::error::Error + 'static)| transport::chain(error);
    let films = queue.films_here().await.map_err(|error| in_words(&error))?;
    let mut unreadable = Ok(());
    for film in films {
        match storage.put(&film.path, &film.file).await {
            Ok(()) => {}
            // One bad file does not keep the others here.
            Err(error @ StorageError::File { .. }) => {
                unreadable = Err(in_words(&error));
                continue;
            }
            Err(error) => return Err(in_words(&error)),
        }
        let forgotten = queue.forget_film(&film).await;
        let forgotten =
            forgotten.map_err(|error| format!("remove {}: {error}", film.file.display()))?;
        if forgotten == Forgotten::Deleted {
            let deleted = storage.delete(&film.path).await;
            deleted.map_err(|error| in_words(&error))?;
        }
    }
    // Folders of deleted campaigns that could not be removed there.
    let removed = queue.finish_removals().await;
    removed.map_err(|error| in_words(&error))?;
    unreadable
}
