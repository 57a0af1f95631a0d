//! Closable value with exclusive access that fails instead of blocking.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};

use pyo3::prelude::*;

use crate::error::{BusyError, ClosedError, failed_to};

/// A value used by at most one thread at a time until it is closed.
pub(crate) struct Guarded<T>(Arc<Inner<T>>);

struct Inner<T> {
    value: Mutex<Option<T>>,
    /// Threads in [`Guarded::try_read`], for example to render a deferred picture. Callers of
    /// [`Guarded::hold`] wait for these: users cannot know when such a picture is rendered.
    readers: AtomicUsize,
}

impl<T> Clone for Guarded<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T> Guarded<T> {
    pub(crate) fn new(value: T) -> Self {
        Self(Arc::new(Inner { value: Mutex::new(Some(value)), readers: AtomicUsize::new(0) }))
    }

    /// Returns the result of `read`; `None` if the value is in use or closed.
    pub(crate) fn try_read<R>(&self, read: impl FnOnce(&mut T) -> Option<R>) -> Option<R> {
        self.0.readers.fetch_add(1, Ordering::SeqCst);
        let result = match self.0.value.try_lock() {
            Ok(mut guard) => guard.as_mut().and_then(read),
            Err(_) => None,
        };
        self.0.readers.fetch_sub(1, Ordering::SeqCst);
        result
    }

    /// Locks the value. Waits only for threads in [`Self::try_read`].
    ///
    /// # Errors
    /// `BusyError` if another thread holds the value; `ClosedError` after a panic.
    pub(crate) fn hold(&self) -> PyResult<MutexGuard<'_, Option<T>>> {
        match self.0.value.try_lock() {
            Ok(guard) => Ok(guard),
            Err(TryLockError::WouldBlock) if self.0.readers.load(Ordering::SeqCst) > 0 => {
                let guard = self.0.value.lock();
                guard.map_err(|_| closed("it failed in an earlier call"))
            }
            Err(TryLockError::WouldBlock) => Err(BusyError::new_err(failed_to(
                "use this environment: another thread is computing with it; give each thread an \
                 environment of its own, or use VectorEnvironment",
            ))),
            Err(TryLockError::Poisoned(_)) => Err(closed("it failed in an earlier call")),
        }
    }

    /// Returns the result of `compute`, which runs while the interpreter is detached.
    ///
    /// # Errors
    /// `BusyError` if another thread holds the value, `ClosedError` if it is closed, and
    /// the errors of `compute`.
    pub(crate) fn with<R: Send>(
        &self,
        py: Python<'_>,
        compute: impl FnOnce(&mut T) -> PyResult<R> + Send,
    ) -> PyResult<R>
    where
        T: Send,
    {
        py.detach(|| compute(self.hold()?.as_mut().ok_or_else(|| closed("close was called"))?))
    }

    /// Frees the value; later uses raise `ClosedError`.
    ///
    /// # Errors
    /// `BusyError` if another thread holds the value; `ClosedError` after a panic.
    pub(crate) fn close(&self) -> PyResult<()> {
        drop(self.hold()?.take());
        Ok(())
    }
}

pub(crate) fn closed(why: &str) -> PyErr {
    ClosedError::new_err(failed_to(format_args!(
        "use this environment: it is closed ({why}); make another one"
    )))
}
