//! Single-flight cache: of several concurrent requests for a key, one computes the value and the
//! others wait for it. The caller decides whether a cached value is fresh enough.
//!
//! A computation of `compute` continues after its callers were cancelled, since a thread cannot be
//! stopped. Its key stays locked until the computation ends, so that reloading a page waits for it
//! and starts no second computation.

use std::collections::HashMap;
use std::future::Future;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::Semaphore;
use tokio::task::JoinError;
use tokio::time::Instant;

/// Most concurrent computations of `compute`, with the reads that prepare them, over all keys.
const COMPUTATIONS: usize = 2;

/// Cache of the newest value of each key, for at most `capacity` keys besides those in use.
#[derive(Debug)]
pub(super) struct SingleFlightCache<V> {
    entries: Mutex<HashMap<String, Entry<V>>>,
    capacity: usize,
    computing: Arc<Semaphore>,
}

/// Entry of a key; its lock is held while the value is being computed.
type Entry<V> = Arc<tokio::sync::Mutex<Option<CachedValue<V>>>>;

/// Cached value with the start and duration of its computation.
#[derive(Clone, Debug)]
pub(super) struct CachedValue<V> {
    pub(super) value: V,
    pub(super) started: Instant,
    pub(super) cost: Duration,
}

impl<V: Clone + Send + 'static> SingleFlightCache<V> {
    /// Creates an empty cache for at most `capacity` keys besides those in use.
    pub(super) fn new(capacity: usize) -> SingleFlightCache<V> {
        SingleFlightCache {
            entries: Mutex::default(),
            capacity,
            computing: Arc::new(Semaphore::new(COMPUTATIONS)),
        }
    }

    /// Returns the cached value of a key if it is fresh, otherwise the result of `make`. If `make`
    /// fails, waiting callers run their own `make`.
    pub(super) async fn get<E>(
        &self,
        key: &str,
        is_fresh: impl FnOnce(&CachedValue<V>) -> bool,
        make: impl Future<Output = Result<V, E>>,
    ) -> Result<V, E> {
        let entry = self.entry(key);
        let mut cached = entry.lock().await;
        if let Some(cached) = cached.as_ref().filter(|cached| is_fresh(cached)) {
            return Ok(cached.value.clone());
        }
        let started = Instant::now();
        let value = make.await?;
        let cost = started.elapsed();
        *cached = Some(CachedValue { value: value.clone(), started, cost });
        Ok(value)
    }

    /// Returns the cached value of a key if it is fresh, otherwise a value computed on a blocking
    /// thread. `read` prepares the computation and is cancelled with its caller; the computation
    /// itself runs to its end. If this fails or the computation panics, which `panicked` converts
    /// to an error, waiting callers start their own computation.
    pub(super) async fn compute<E, C>(
        &self,
        key: &str,
        is_fresh: impl FnOnce(&CachedValue<V>) -> bool,
        read: impl Future<Output = Result<C, E>>,
        panicked: impl FnOnce(&JoinError) -> E,
    ) -> Result<V, E>
    where
        E: Send + 'static,
        C: FnOnce() -> Result<V, E> + Send + 'static,
    {
        let mut cached = self.entry(key).lock_owned().await;
        if let Some(cached) = cached.as_ref().filter(|cached| is_fresh(cached)) {
            return Ok(cached.value.clone());
        }
        let started = Instant::now();
        let permit = self.computing.clone().acquire_owned().await;
        let computation = read.await?;
        let computed = tokio::task::spawn_blocking(move || {
            let _permit = permit;
            let value = computation()?;
            *cached = Some(CachedValue { value: value.clone(), started, cost: started.elapsed() });
            Ok(value)
        });
        computed.await.unwrap_or_else(|error| Err(panicked(&error)))
    }

    fn entry(&self, key: &str) -> Entry<V> {
        // No code panics while holding this lock, so the map is never left inconsistent.
        let mut entries = self.entries.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(entry) = entries.get(key) {
            return entry.clone();
        }
        if entries.len() >= self.capacity {
            // Evicts every entry that no caller holds; values being computed stay.
            entries.retain(|_, entry| Arc::strong_count(entry) > 1);
        }
        entries.entry(key.to_owned()).or_default().clone()
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    #[tokio::test]
    async fn concurrent_requests_share_one_computation() {
        let cache = SingleFlightCache::new(2);
        let computed = AtomicU32::new(0);
        let request = || {
            cache.get("page", |_| true, async {
                tokio::task::yield_now().await;
                Ok::<_, Infallible>(computed.fetch_add(1, Ordering::Relaxed))
            })
        };
        let (a, b, c) = tokio::join!(request(), request(), request());
        assert_eq!((a, b, c), (Ok(0), Ok(0), Ok(0)));
        let again = cache.get("page", |_| false, async { Ok::<_, Infallible>(7) });
        assert_eq!(again.await, Ok(7));
    }

    /// Regression: reloading a page while its statistics were computed started another
    /// computation.
    #[tokio::test]
    async fn an_abandoned_computation_is_not_started_again() {
        let cache = SingleFlightCache::new(2);
        let begun = Arc::new(AtomicU32::new(0));
        let (release, gate) = std::sync::mpsc::channel::<()>();
        let gate = Arc::new(Mutex::new(gate));
        let request = || {
            let (begun, gate) = (begun.clone(), gate.clone());
            let computation = move || {
                let number = begun.fetch_add(1, Ordering::Relaxed);
                let gate = gate.lock().expect("unpoisoned");
                gate.recv().expect("a release");
                Ok(number)
            };
            let read = async { Ok::<_, String>(computation) };
            cache.compute("page", |_| true, read, JoinError::to_string)
        };
        for _ in 0..5 {
            let timed_out = tokio::time::timeout(Duration::from_millis(20), request()).await;
            assert!(timed_out.is_err(), "the computation is not finished");
        }
        // Sends enough signals for six computations, in case several were started.
        (0..6).for_each(|_| release.send(()).expect("a waiting computation"));
        assert_eq!(request().await, Ok(0));
        assert_eq!(begun.load(Ordering::Relaxed), 1);
    }

    /// Each read occupies a reader of the database, which other queries need.
    #[tokio::test]
    async fn only_a_few_computations_read_at_a_time() {
        let cache = SingleFlightCache::<()>::new(9);
        let reading = AtomicU32::new(0);
        let compute = async |key: u32| {
            let read = async {
                reading.fetch_add(1, Ordering::Relaxed);
                std::future::pending::<Result<fn() -> Result<(), String>, String>>().await
            };
            cache.compute(&key.to_string(), |_| true, read, JoinError::to_string).await
        };
        let all = futures_util::future::join_all((0..9).map(compute));
        tokio::time::timeout(Duration::from_millis(20), all).await.expect_err("they never end");
        assert_eq!(reading.load(Ordering::Relaxed), COMPUTATIONS as u32);
    }

    #[tokio::test]
    async fn failures_are_not_cached_and_entries_are_bounded() {
        let cache = SingleFlightCache::new(2);
        let failed = cache.get("a", |_| true, async { Err("no") }).await;
        assert_eq!(failed, Err("no"));
        for key in ["a", "b", "c"] {
            let cached = cache.get(key, |_| true, async { Ok::<_, &str>(key.len()) });
            assert_eq!(cached.await, Ok(1));
        }
        assert!(cache.entries.lock().expect("unpoisoned").len() <= 2);
    }
}
