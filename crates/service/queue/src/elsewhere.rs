//! Storage of videos beyond the data folder, as a trait, so that tests and programs can choose it.

use std::future::Future;
use std::pin::Pin;

/// Storage of videos beyond the data folder, addressed by their paths below the data folder.
pub trait Elsewhere: Send + Sync {
    /// Removes everything below a folder, or returns the reason why it cannot.
    fn remove<'a>(
        &'a self,
        folder: &'a str,
    ) -> Pin<Box<dyn Future<Output = Result<(), String>> + Send + 'a>>;
}
