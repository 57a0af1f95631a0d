//! Uploads videos after their results. Videos have the lowest priority: few are sent at a time,
//! and a video that cannot be sent in time is dropped, so that no result, lease or slot waits for
//! it.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use benchmark::attempt::AttemptId;
use tokio::sync::Semaphore;
use tonic::Status;
use transport::chain;

use super::link::Link;

const UPLOADS_AT_A_TIME: usize = 3;
/// Longest wait for a video's upload, including its time in the queue.
const UPLOAD_TIMEOUT: Duration = Duration::from_secs(120);

/// Video of a committed result, to be uploaded.
#[derive(Debug)]
pub(crate) struct Upload {
    pub(crate) attempt: AttemptId,
    pub(crate) file: PathBuf,
    /// Name of the rollout in messages.
    pub(crate) label: String,
}

/// Uploads videos, a few in parallel.
#[derive(Clone, Debug)]
pub(crate) struct Uploader {
    link: Link,
    permits: Arc<Semaphore>,
}

impl Uploader {
    pub(crate) fn new(link: Link) -> Self {
        Self { link, permits: Arc::new(Semaphore::new(UPLOADS_AT_A_TIME)) }
    }

    /// Uploads a video, or drops it and logs the reason. Removes the video's file in either case.
    pub(crate) async fn upload(self, upload: Upload) {
        let sending = async {
            // The semaphore is never closed.
            let _permit = self.permits.acquire().await;
            self.link.put_video(upload.attempt, &upload.file).await
        };
        let sent = tokio::time::timeout(UPLOAD_TIMEOUT, sending).await;
        let sent =
            sent.unwrap_or_else(|_| Err(Status::deadline_exceeded("the upload took too long")));
        if let Err(status) = sent {
            let (label, problem) = (&upload.label, chain(&status));
            tracing::warn!("the video of {label} is dropped: {problem}");
        }
        remove(upload.file).await;
    }
}

/// Removes a video's file, if it exists.
pub(crate) async fn remove(file: PathBuf) {
    match tokio::fs::remove_file(&file).await {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            tracing::warn!("{} cannot be removed: {error}", file.display());
        }
        _ => {}
    }
}
