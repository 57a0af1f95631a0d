//! Limits the memory of observations in flight, so that a stalled server does not fill the
//! gateway's memory with frames.

use proto::policy::InferRequest;
use tokio::sync::{Semaphore, SemaphorePermit};

/// Limit of observations in flight, bytes: 682 pairs of 256 × 256 frames, more than ten machines
/// of 64 slots send at a time.
pub const MAX_OBSERVATION_BYTES: usize = 256 << 20;
/// Smallest size counted for a query, bytes, so that queries without frames are limited, too.
pub const MIN_QUERY_BYTES: usize = 64 << 10;

/// Memory budget of the observations whose queries are unanswered.
#[derive(Debug)]
pub struct ObservationBudget(Semaphore);

impl Default for ObservationBudget {
    fn default() -> Self {
        Self(Semaphore::new(MAX_OBSERVATION_BYTES))
    }
}

impl ObservationBudget {
    /// Reserves memory for a query's observation until the permit is dropped; `None` if the budget
    /// is exhausted.
    pub fn reserve(&self, query: &InferRequest) -> Option<SemaphorePermit<'_>> {
        let frames = query.observation.iter().flat_map(|observation| &observation.images);
        let bytes = frames.map(|frame| frame.rgb.len()).sum::<usize>();
        // Messages are far smaller than 4 GiB.
        let bytes = u32::try_from(bytes.max(MIN_QUERY_BYTES)).ok()?;
        self.0.try_acquire_many(bytes).ok()
    }
}

#[cfg(test)]
mod tests {
    use proto::policy::{Image, Observation};

    use super::*;

    fn query(frame_bytes: usize) -> InferRequest {
        let frame = Image { rgb: vec![0; frame_bytes].into(), ..Image::default() };
        InferRequest {
            observation: Some(Observation { images: vec![frame], ..Observation::default() }),
            ..InferRequest::default()
        }
    }

    #[test]
    fn memory_is_reserved_up_to_the_limit_and_released_after_answers() {
        let budget = ObservationBudget::default();
        let large = query(MAX_OBSERVATION_BYTES - MIN_QUERY_BYTES);
        let first = budget.reserve(&large).expect("memory");
        let second = budget.reserve(&query(0)).expect("memory for a query without frames");
        assert!(budget.reserve(&query(0)).is_none());
        drop(first);
        assert!(budget.reserve(&large).is_some());
        drop(second);
    }
}
