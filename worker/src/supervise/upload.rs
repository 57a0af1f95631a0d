//! Videos on their way to the coordinator, after their results. A video is worth
//! less than anything else: it is tried for a while, a few at a time, and then
//! dropped, so that neither a result, a lease nor a slot waits for it.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use rollout_types::AttemptId;
use tokio::sync::Semaphore;
use tonic::Status;
use transport::chain;

use super::link::Link;

/// Videos that are sent at a time; others wait.
const UPLOADS_AT_A_TIME: usize = 3;
/// Longest time from a committed result to its stored video.
const PATIENCE: Duration = Duration::from_secs(120);

/// A video of a committed result.
#[derive(Debug)]
pub(crate) struct Upload {
    pub(crate) attempt: AttemptId,
    pub(crate) file: PathBuf,
    /// Name of the rollout in messages.
    pub(crate) label: String,
}

/// Sends videos, a few at a time.
#[derive(Clone, Debug)]
pub(crate) struct Uploader {
    link: Link,
    places: Arc<Semaphore>,
}

impl Uploader {
    pub(crate) fn new(link: Link) -> Self {
        Self {
            link,
            places: Arc::new(Semaphore::new(UPLOADS_AT_A_TIME)),
        }
    }

    /// Sends a video, or drops it and says so. The file is gone afterwards.
    pub(crate) async fn upload(self, upload: Upload) {
        let sending = async {
            // Never closed.
            let _place = self.places.acquire().await;
            self.link.put_video(upload.attempt, &upload.file).await
        };
        let sent = tokio::time::timeout(PATIENCE, sending).await;
        let sent = sent.unwrap_or_else(|_| Err(Status::deadline_exceeded("out of patience")));
        if let Err(status) = sent {
            let (label, problem) = (&upload.label, chain(&status));
            tracing::warn!("the video of {label} is dropped: {problem}");
        }
        remove(upload.file).await;
    }
}

/// Removes a video, if there is one.
pub(crate) async fn remove(file: PathBuf) {
    match tokio::fs::remove_file(&file).await {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            tracing::warn!("{} stays behind: {error}", file.display());
        }
        _ => {}
    }
}
