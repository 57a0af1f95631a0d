//! Decision about the next step of a search.

/// Next step of a search whose requests are of the type `R`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Decision<R> {
    /// Run this batch; it is not empty.
    Run(Vec<R>),
    Wait,
    /// The configuration has nothing to search for, or no rollout is left to run.
    Done,
}

impl<R> Decision<R> {
    /// Returns the decision to run a batch, or [`Self::Done`] if the batch is empty.
    pub(crate) fn run(batch: Vec<R>) -> Self {
        if batch.is_empty() { Self::Done } else { Self::Run(batch) }
    }
}
