//! Chaos testing: real coordinators, gateways, policies and workers as processes,
//! connections between them that can be cut, and schedules of faults derived from a
//! seed. This module injects and repairs faults; the tests assert what must hold
//! afterwards.

mod fleet;
mod schedule;
mod system;
mod wire;

pub use fleet::{Fleet, LEASE, Plan, SlotKind};
pub use schedule::{Fault, Link, Schedule};
pub use wire::Wire;
