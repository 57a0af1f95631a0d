//! Decisions of the queue, as pure functions: no store, no clock, no generator of their own.

pub mod campaign;
pub mod choice;
pub mod lease;
pub mod outage;
pub(crate) mod pairing;
