//! Things that cost something to make and that many ask for at once: one of
//! them makes it, the others wait and share it. What is fresh enough is for the
//! caller to say.

use std::collections::HashMap;
use std::future::Future;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::time::Instant;

/// The newest value of every key, at most so many.
#[derive(Debug)]
pub(super) struct Kept<V> {
    places: Mutex<HashMap<String, Place<V>>>,
    most: usize,
}

/// Held while its value is being made.
type Place<V> = Arc<tokio::sync::Mutex<Option<Made<V>>>>;

/// A value, when it was begun, and how long making it took.
#[derive(Clone, Debug)]
pub(super) struct Made<V> {
    pub(super) value: V,
    pub(super) at: Instant,
    pub(super) cost: Duration,
}

impl<V: Clone> Kept<V> {
    /// Nothing yet; later at most `most` values.
    pub(super) fn new(most: usize) -> Kept<V> {
        Kept {
            places: Mutex::default(),
            most,
        }
    }

    /// The value of a key: the one that is there, if it is fresh, or a new one.
    ///
    /// # Errors
    /// Those of `make`, to its caller alone.
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

    fn place(&self, key: &str) -> Place<V> {
        // Nothing panics while it holds this.
        let mut places = self.places.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(place) = places.get(key) {
            return place.clone();
        }
        if places.len() >= self.most {
            // What is still wanted is made again, once.
            places.clear();
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
