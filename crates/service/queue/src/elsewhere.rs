//! Storage of films beyond the data folder, as a trait, so that tests and programs can choose it.

use std::future::Future;
use std::pin::Pin;

/// Storage of films beyond the data folder, by their paths below it.
pub trait Elsewhere: Send + Sync {
    /// Removes whatever is below a folder, or says why it cannot.
    fn remove<'a>(
        &'a self,
        folder: &'a str,
    ) -> Pin<Box<dyn Future<Output = Result<(), String>> + Send + 'a>>;
}
