//! Arrays of a mesh or texture: owned while they are made, or in bytes that somebody else
//! keeps, such as a mapped file.

use std::ops::Deref;

use bytemuck::{AnyBitPattern, NoUninit};
use bytes::Bytes;

/// An array that only its maker changes.
#[derive(Debug, Clone)]
pub(crate) enum Values<T> {
    /// Being made, or made here.
    Own(Vec<T>),
    /// Aligned for `T` and of a whole number of them; checked once.
    Shared(Bytes),
}

impl<T> Default for Values<T> {
    fn default() -> Self {
        Self::Own(Vec::new())
    }
}

impl<T> Values<T> {
    /// No values yet, and room for so many.
    pub(crate) fn with_capacity(count: usize) -> Self {
        Self::Own(Vec::with_capacity(count))
    }
}

impl<T: AnyBitPattern> Values<T> {
    /// The values that lie in bytes; none if those are not aligned for them or end amid one.
    pub(crate) fn shared(bytes: Bytes) -> Option<Self> {
        bytemuck::try_cast_slice::<u8, T>(&bytes).ok()?;
        Some(Self::Shared(bytes))
    }
}

impl<T: NoUninit + AnyBitPattern> Values<T> {
    /// Appends a value; shared values are copied first.
    pub(crate) fn push(&mut self, value: T) {
        self.own().push(value);
    }

    /// Appends values; shared ones are copied first.
    pub(crate) fn extend(&mut self, values: &[T]) {
        self.own().extend_from_slice(values);
    }

    fn own(&mut self) -> &mut Vec<T> {
        if let Self::Shared(_) = self {
            *self = Self::Own(self.to_vec());
        }
        match self {
            Self::Own(values) => values,
            Self::Shared(_) => unreachable!("copied above"),
        }
    }
}

impl<T: AnyBitPattern> Deref for Values<T> {
    type Target = [T];

    #[inline(always)]
    fn deref(&self) -> &[T] {
        match self {
            Self::Own(values) => values,
            Self::Shared(bytes) => bytemuck::cast_slice(bytes),
        }
    }
}

/// Numbers at the head of a blob and the arrays behind them.
pub(crate) struct Blob {
    bytes: Bytes,
}

impl Blob {
    pub(crate) fn new(bytes: Bytes) -> Self {
        Self { bytes }
    }

    /// Takes the next `count` values; none if there are fewer, or they are not aligned.
    pub(crate) fn take<T: AnyBitPattern>(&mut self, count: usize) -> Option<Values<T>> {
        let length = count.checked_mul(size_of::<T>())?;
        if length > self.bytes.len() {
            return None;
        }
        Values::shared(self.bytes.split_to(length))
    }

    /// Returns true if nothing is left.
    pub(crate) fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }
}
