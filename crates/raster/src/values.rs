//! Arrays of a mesh or texture, either owned or borrowed from shared bytes such as a mapped file.

use std::ops::Deref;

use bytemuck::{AnyBitPattern, NoUninit};
use bytes::Bytes;

#[derive(Debug, Clone)]
pub(crate) enum Values<T> {
    Owned(Vec<T>),
    /// Shared bytes, whose alignment and length were checked once.
    Shared(Bytes),
}

impl<T> Default for Values<T> {
    fn default() -> Self {
        Self::Owned(Vec::new())
    }
}

impl<T> Values<T> {
    pub(crate) fn with_capacity(count: usize) -> Self {
        Self::Owned(Vec::with_capacity(count))
    }
}

impl<T: AnyBitPattern> Values<T> {
    /// Views bytes as values; `None` if they are misaligned or end within a value.
    pub(crate) fn shared(bytes: Bytes) -> Option<Self> {
        bytemuck::try_cast_slice::<u8, T>(&bytes).ok()?;
        Some(Self::Shared(bytes))
    }
}

impl<T: NoUninit + AnyBitPattern> Values<T> {
    /// Appends a value; shared values are copied first.
    pub(crate) fn push(&mut self, value: T) {
        self.owned_mut().push(value);
    }

    /// Appends values; shared values are copied first.
    pub(crate) fn extend(&mut self, values: &[T]) {
        self.owned_mut().extend_from_slice(values);
    }

    fn owned_mut(&mut self) -> &mut Vec<T> {
        if let Self::Shared(_) = self {
            *self = Self::Owned(self.to_vec());
        }
        match self {
            Self::Owned(values) => values,
            Self::Shared(_) => unreachable!("copied above"),
        }
    }
}

impl<T: AnyBitPattern> Deref for Values<T> {
    type Target = [T];

    #[inline(always)]
    fn deref(&self) -> &[T] {
        match self {
            Self::Owned(values) => values,
            Self::Shared(bytes) => bytemuck::cast_slice(bytes),
        }
    }
}

pub(crate) struct Blob {
    bytes: Bytes,
}

impl Blob {
    pub(crate) fn new(bytes: Bytes) -> Self {
        Self { bytes }
    }

    /// Takes the next `count` values; `None` if there are fewer, or they are misaligned.
    pub(crate) fn take<T: AnyBitPattern>(&mut self, count: usize) -> Option<Values<T>> {
        let length = count.checked_mul(size_of::<T>())?;
        if length > self.bytes.len() {
            return None;
        }
        Values::shared(self.bytes.split_to(length))
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }
}
