//! Single-flight cache: of several concurrent requests for a key, one computes the value. The caller
//! decides whether a cached value is fresh enough, and whether it waits for the computation to end
//! ([`get`](SingleFlightCache::get)) or takes the newest value meanwhile
//! ([`newest`](SingleFlightCache::newest)).

use std::collections::HashMap;
use std::future::Future;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio::time::Instant;

/// Most concurrent computations of `newest`, with the reads that prepare them, over all keys.
const COMPUTATIONS: usize = 2;
/// Longest wait of `newest` for a computation.
const PATIENCE: Duration = Duration::from_millis(500);

/// Cache of the newest value of each key, for at most `capacity` keys besides those in use.
#[derive(Debug)]
pub(super) struct SingleFlightCache<V> {
    entries: Mutex<HashMap<String, Arc<Entry<V>>>>,
    capacity: usize,
    computations: Arc<Semaphore>,
    /// Computations of `newest` in progress.
    tasks: Mutex<JoinSet<()>>,
}

#[derive(Debug)]
struct Entry<V> {
    /// Locked while a value is being computed.
    computing: Arc<tokio::sync::Mutex<()>>,
    newest: Mutex<Option<CachedValue<V>>>,
}

/// Cached value with the start and duration of its computation.
#[derive(Clone, Debug)]
pub(super) struct CachedValue<V> {
    pub(super) value: V,
    pub(super) started: Instant,
    pub(super) cost: Duration,
}

impl<V: Clone> Entry<V> {
    fn newest(&self) -> Option<CachedValue<V>> {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn store(&self, value: V, started: Instant) {
        let newest = CachedValue { value, started, cost: started.elapsed() };
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(newest);
    }
}

impl<V: Clone + Send + 'static> SingleFlightCache<V> {
    /// Creates an empty cache for at most `capacity` keys besides those in use.
    pub(super) fn new(capacity: usize) -> SingleFlightCache<V> {
        SingleFlightCache {
            entries: Mutex::default(),
            capacity,
            computations: Arc::new(Semaphore::new(COMPUTATIONS)),
            tasks: Mutex::default(),
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
        let _computing = entry.computing.lock().await;
        if let Some(cached) = entry.newest().filter(is_fresh) {
            return Ok(cached.value);
        }
        let started = Instant::now();
        let value = make.await?;
        entry.store(value.clone(), started);
        Ok(value)
    }

    /// Returns the cached value of a key if it is fresh. Otherwise computes one with `make`, unless
    /// that is under way, and returns the newest value after [`PATIENCE`] at most; `None` if there
    /// is none yet. A computation continues after its callers have left.
    pub(super) async fn newest(
        &self,
        key: &str,
        is_fresh: impl FnOnce(&CachedValue<V>) -> bool,
        make: impl Future<Output = V> + Send + 'static,
    ) -> Option<V> {
        let entry = self.entry(key);
        if let Some(cached) = entry.newest().filter(is_fresh) {
            return Some(cached.value);
        }
        if let Ok(computing) = entry.computing.clone().try_lock_owned() {
            let (entry, computations) = (entry.clone(), self.computations.clone());
            let mut tasks = self.tasks.lock().unwrap_or_else(PoisonError::into_inner);
            // Reaps finished tasks; the log has the panic of one that did not finish.
            while tasks.try_join_next().is_some() {}
            tasks.spawn(async move {
                let _computing = computing;
                let started = Instant::now();
                // The semaphore is never closed.
                let _permit = computations.acquire().await;
                entry.store(make.await, started);
            });
        }
        let _ = tokio::time::timeout(PATIENCE, entry.computing.lock()).await;
        entry.newest().map(|cached| cached.value)
    }

    fn entry(&self, key: &str) -> Arc<Entry<V>> {
        // No code panics while holding this lock, so the map is never left inconsistent.
        let mut entries = self.entries.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(entry) = entries.get(key) {
            return entry.clone();
        }
        if entries.len() >= self.capacity {
            // Evicts every entry that no caller holds; values being computed stay.
            entries.retain(|_, entry| Arc::strong_count(entry) > 1);
        }
        let new = Entry { computing: Arc::default(), newest: Mutex::default() };
        entries.entry(key.to_owned()).or_insert(Arc::new(new)).clone()
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

    /// Regressions: the first page of a large campaign after a restart waited 12 s for the
    /// statistics; reloading it meanwhile started another computation.
    #[tokio::test]
    async fn a_slow_computation_runs_once_and_holds_up_no_reader() {
        let cache = SingleFlightCache::new(2);
        let release = Arc::new(Semaphore::new(0));
        let begun = Arc::new(AtomicU32::new(0));
        let newest = async |is_fresh: bool| {
            let (release, begun) = (release.clone(), begun.clone());
            let make = async move {
                let number = begun.fetch_add(1, Ordering::Relaxed);
                release.acquire().await.expect("an open semaphore").forget();
                number
            };
            cache.newest("page", |_| is_fresh, make).await
        };
        for _ in 0..3 {
            assert_eq!(newest(true).await, None);
        }
        release.add_permits(1);
        assert_eq!(newest(true).await, Some(0));
        assert_eq!(newest(true).await, Some(0), "fresh");
        assert_eq!(newest(false).await, Some(0), "the newest one, while another is computed");
        release.add_permits(1);
        assert_eq!(newest(true).await, Some(0), "fresh");
        while newest(true).await != Some(1) {
            tokio::task::yield_now().await;
        }
        assert_eq!(begun.load(Ordering::Relaxed), 2);
    }

    /// Each read occupies a reader of the database, which other queries need.
    #[tokio::test]
    async fn only_a_few_computations_read_at_a_time() {
        let cache = SingleFlightCache::<()>::new(9);
        let reading = Arc::new(AtomicU32::new(0));
        let compute = async |key: u32| {
            let reading = reading.clone();
            let read = async move {
                reading.fetch_add(1, Ordering::Relaxed);
                std::future::pending().await
            };
            cache.newest(&key.to_string(), |_| true, read).await
        };
        futures_util::future::join_all((0..9).map(compute)).await;
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
