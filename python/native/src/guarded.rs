//! Value that at most one thread uses at a time.

use std::sync::{Arc, Mutex, MutexGuard, TryLockError};

use pyo3::prelude::*;

use crate::error::{BusyError, ClosedError};

/// A value that is in use by one thread at a time, until it is closed.
pub(crate) struct Guarded<T>(Arc<Mutex<Option<T>>>);

impl<T> Clone for Guarded<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T> Guarded<T> {
    pub(crate) fn new(value: T) -> Self {
        Self(Arc::new(Mutex::new(Some(value))))
    }

    /// Takes hold of it without waiting.
    ///
    /// # Errors
    /// `BusyError` while another thread holds it.
    pub(crate) fn hold(&self) -> PyResult<MutexGuard<'_, Option<T>>> {
        match self.0.try_lock() {
            Ok(guard) => Ok(guard),
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
