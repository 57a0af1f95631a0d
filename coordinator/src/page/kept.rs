//! Single-flight cache: of several concurrent requests for a key, one computes the value and the
//! others wait for it. The caller decides whether a cached value is fresh enough.
//!
//! A computation outlives its cancelled callers, since a thread cannot be stopped. Its key stays
//! locked until it ends, so that reloading a page waits for the running computation and starts no
//! second one.

use std::collections::HashMap;
use std::future::Future;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::Semaphore;
use tokio::task::JoinError;
use tokio::time::Instant;

/// Most concurrent computations over all keys.
const COMPUTATIONS: usize = 2;

/// Cache of the newest value of each key, for at most `most` keys.
#[derive(Debug)]
pub(super) struct Kept<V> {
    places: Mutex<HashMap<String, Place<V>>>,
    most: usize,
    computing: Arc<Semaphore>,
}

/// Entry of a key; its lock is held while the value is being computed.
type Place<V> = Arc<tokio::sync::Mutex<Option<Made<V>>>>;

/// Cached value with the start and duration of its computation.
#[derive(Clone, Debug)]
pub(super) struct Made<V> {
    pub(super) value: V,
    pub(super) at: Instant,
    pub(super) cost: Duration,
}

impl<V: Clone + Send + 'static> Kept<V> {
    /// Creates an empty cache for at most `most` keys.
    pub(super) fn new(most: usize) -> Kept<V> {
        Kept {
            places: Mutex::default(),
            most,
            computing: Arc::new(Semaphore::new(COMPUTATIONS)),
        }
    }

    /// Returns the cached value of a key if it is fresh, otherwise the result of `make`.
    ///
    /// # Errors
    /// If `make` fails; waiting callers then run their own `make`.
    pub(super) async fn get<E>(
        &self,
        key: &str,
        is_fresh: impl FnOnce(&Made<V>) -> bool,
        make: impl Future<Output = Result<V, E>>,
    ) -> Result<V, E> {
        let place = self.place(key);
        let mut made = place.lock().await;
        if let Some(made) = made.as_ref().filter(|made| is_fresh(made)) {
            return Ok(made.value.clone());
        }
        let at = Instant::now();
        let value = make.await?;
        let cost = at.elapsed();
        *made = Some(Made {
            value: value.clone(),
            at,
            cost,
        });
        Ok(value)
    }

    /// Returns the cached value of a key if it is fresh, otherwise one computed on a blocking
    /// thread. `read` prepares the computation and is cancelled with its caller; the computation
    /// itself runs to its end.
    ///
    /// # Errors
    /// If `read` or the computation fails, or, as converted by `panicked`, if the computation
    /// panics. Waiting callers then start their own computation.
    pub(super) async fn compute<E, C>(
        &self,
        key: &str,
        is_fresh: impl FnOnce(&Made<V>) -> bool,
        read: impl Future<Output = Result<C, E>>,
        panicked: impl FnOnce(&JoinError) -> E,
    ) -> Result<V, E>
    where
        E: Send + 'static,
        C: FnOnce() -> Result<V, E> + Send + 'static,
    {
        let mut made = self.place(key).lock_owned().await;
        if let Some(made) = made.as_ref().filter(|made| is_fresh(made)) {
            return Ok(made.value.clone());
        }
        let at = Instant::now();
        let computation = read.await?;
        let turn = self.computing.clone().acquire_owned().await;
        let computed = tokio::task::spawn_blocking(move || {
            let _turn = turn;
            let value = computation()?;
            *made = Some(Made {
                value: value.clone(),
                at,
                cost: at.elapsed(),
            });
            Ok(value)
        });
        computed.await.unwrap_or_else(|error| Err(panicked(&error)))
    }

    fn place(&self, key: &str) -> Place<V> {
        // No code panics while holding this lock, so the map is never left inconsistent.
        let mut places = self.places.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(place) = places.get(key) {
            return place.clone();
        }
        if places.len() >= self.most {
            // Evicts every entry that no caller holds; values being computed stay.
            places.retain(|_, place| Arc::strong_count(place) > 1);
        }
        places.entry(key.to_owned()).or_default().clone()
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    #[tokio::test]
    async fn many_who_ask_at_once_share_what_one_makes() {
        let kept = Kept::new(2);
        let made = AtomicU32::new(0);
        let ask = || {
            kept.get("page", |_| true, async {
                tokio::task::yield_now().await;
                Ok::<_, Infallible>(made.fetch_add(1, Ordering::Relaxed))
            })
        };
        let (a, b, c) = tokio::join!(ask(), ask(), ask());
        assert_eq!((a, b, c), (Ok(0), Ok(0), Ok(0)));
        let again = kept.get("page", |_| false, async { Ok::<_, Infallible>(7) });
        assert_eq!(again.await, Ok(7));
    }

    /// Regression B12: reloading a page while its statistics were computed started another
    /// computation.
    #[tokio::test]
    async fn a_computation_that_nobody_waits_for_any_more_is_not_begun_again() {
        let kept = Kept::new(2);
        let begun = Arc::new(AtomicU32::new(0));
        let (go_on, gate) = std::sync::mpsc::channel::<()>();
        let gate = Arc::new(Mutex::new(gate));
        let ask = || {
            let (begun, gate) = (begun.clone(), gate.clone());
            let computation = move || {
                let number = begun.fetch_add(1, Ordering::Relaxed);
                let gate = gate.lock().expect("unpoisoned");
                gate.recv().expect("it goes on");
                Ok(number)
            };
            let read = async { Ok::<_, String>(computation) };
            kept.compute("page", |_| true, read, JoinError::to_string)
        };
        for _ in 0..5 {
            let given_up = tokio::time::timeout(Duration::from_millis(20), ask()).await;
            assert!(given_up.is_err(), "the computation waits");
        }
        // Enough signals for every computation, had several been started.
        (0..6).for_each(|_| go_on.send(()).expect("the gate is there"));
        assert_eq!(ask().await, Ok(0));
        assert_eq!(begun.load(Ordering::Relaxed), 1);
    }

    #[tokio::test]
    async fn a_failure_is_not_kept_and_keys_are_bounded() {
        let kept = Kept::new(2);
        let failed = kept.get("a", |_| true, async { Err("no") }).await;
        assert_eq!(failed, Err("no"));
        for key in ["a", "b", "c"] {
            let made = kept.get(key, |_| true, async { Ok::<_, &str>(key.len()) });
            assert_eq!(made.await, Ok(1));
        }
        assert!(kept.places.lock().expect("unpoisoned").len() <= 2);
    }
}
