//! Container whose value may be used and freed only on the thread that created it.

use std::mem::ManuallyDrop;
use std::thread::{self, ThreadId};

/// A value that only its own thread can access. If another thread drops it, the value is leaked.
pub(crate) struct ThreadBound<T> {
    owner: ThreadId,
    value: ManuallyDrop<T>,
}

// SAFETY: no other thread than the owner reaches the value, not even to drop it.
unsafe impl<T> Send for ThreadBound<T> {}

impl<T> ThreadBound<T> {
    pub(crate) fn new(value: T) -> Self {
        Self { owner: thread::current().id(), value: ManuallyDrop::new(value) }
    }

    fn is_owner_thread(&self) -> bool {
        self.owner == thread::current().id()
    }

    /// Returns the value; `None` on another thread.
    pub(crate) fn get(&self) -> Option<&T> {
        self.is_owner_thread().then(|| &*self.value)
    }

    /// Returns the value for mutation.
    ///
    /// # Panics
    /// On another thread.
    pub(crate) fn get_mut(&mut self) -> &mut T {
        assert!(self.is_owner_thread(), "the value belongs to another thread");
        &mut self.value
    }
}

impl<T> Drop for ThreadBound<T> {
    fn drop(&mut self) {
        if self.is_owner_thread() {
            // SAFETY: dropped once, here.
            unsafe { ManuallyDrop::drop(&mut self.value) }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::rc::Rc;

    use super::*;

    #[test]
    fn other_threads_can_neither_access_nor_drop_the_value() {
        let value = Rc::new(());
        let [moved, kept] = [(); 2].map(|()| ThreadBound::new(Rc::clone(&value)));
        assert!(kept.get().is_some());
        let other_thread = thread::spawn(move || moved.get().is_none());
        assert!(other_thread.join().expect("a thread that ends"));
        assert_eq!(Rc::strong_count(&value), 3, "the other thread has dropped the value");
        drop(kept);
        assert_eq!(Rc::strong_count(&value), 2);
    }
}
