//! Value that at most one thread uses at a time.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};

use pyo3::prelude::*;

use crate::error::{BusyError, ClosedError};

/// A value that is in use by one thread at a time, until it is closed.
pub(crate) struct Guarded<T>(Arc<Inner<T>>);

struct Inner<T> {
    value: Mutex<Option<T>>,
    /// Threads that only look at it. Whoever computes waits for them: they change nothing,
    /// and nobody can know when a picture is drawn.
    looking: AtomicUsize,
}

impl<T> Clone for Guarded<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T> Guarded<T> {
    pub(crate) fn new(value: T) -> Self {
        Self(Arc::new(Inner {
            value: Mutex::new(Some(value)),
            looking: AtomicUsize::new(0),
        }))
    }

    /// Looks at it, unless it is in use or closed.
    pub(crate) fn look<R>(&self, look: impl FnOnce(&mut T) -> Option<R>) -> Option<R> {
        self.0.looking.fetch_add(1, Ordering::SeqCst);
        let seen = match self.0.value.try_lock() {
            Ok(mut held) => held.as_mut().and_then(look),
            Err(_) => None,
        };
        self.0.looking.fetch_sub(1, Ordering::SeqCst);
        seen
    }

    /// Takes hold of it, and waits for nobody but those who look at it.
    ///
    /// # Errors
    /// `BusyError` while another thread holds it.
    pub(crate) fn hold(&self) -> PyResult<MutexGuard<'_, Option<T>>> {
        match self.0.value.try_lock() {
            Ok(guard) => Ok(guard),
            Err(TryLockError::WouldBlock) if self.0.looking.load(Ordering::SeqCst) > 0 => {
                let held = self.0.value.lock();
                held.map_err(|_| closed("it failed in an earlier call"))
            }
            Err(TryLockError::WouldBlock) => Err(BusyError::new_err(
                "use this environment: another thread is computing with it; give each thread an \
                 environment of its own, or use VectorEnvironment",
            )),
            // A panic left it half way.
            Err(TryLockError::Poisoned(_)) => Err(closed("it failed in an earlier call")),
        }
    }

    /// Computes with it, the interpreter let go of.
    ///
    /// # Errors
    /// Those of `compute`; `BusyError`; `ClosedError`.
    pub(crate) fn with<R: Send>(
        &self,
        py: Python<'_>,
        compute: impl FnOnce(&mut T) -> PyResult<R> + Send,
    ) -> PyResult<R>
    where
        T: Send,
    {
        py.detach(|| {
            compute(
                self.hold()?
                    .as_mut()
                    .ok_or_else(|| closed("close was called"))?,
            )
        })
    }

    /// Frees the value; further uses are errors.
    ///
    /// # Errors
    /// `BusyError`.
    pub(crate) fn close(&self) -> PyResult<()> {
        drop(self.hold()?.take());
        Ok(())
    }
}

pub(crate) fn closed(why: &str) -> PyErr {
    ClosedError::new_err(format!(
        "use this environment: it is closed ({why}); make another one"
    ))
}
