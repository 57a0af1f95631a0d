//! Remote storage of videos, as a trait, so that programs and tests can choose the implementation.

use std::future::Future;
use std::pin::Pin;

/// Remote storage of videos, addressed by their paths below the data folder.
pub trait RemoteStorage: Send + Sync {
    /// Removes everything below a folder. The error is a message that follows "failed to …".
    fn remove<'a>(
        &'a self,
        folder: &'a str,
    ) -> Pin<Box<dyn Future<Output = Result<(), String>> + Send + 'a>>;
}
