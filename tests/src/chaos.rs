//! Breaking a running system on purpose: real coordinators, gateways, policies
//! and workers as processes, with wires between them that can be cut, and
//! schedules of faults that follow from a seed. Responsible for the breaking and
//! for putting back; what must hold afterwards is the test's.

mod fleet;
mod schedule;
mod wire;

pub use fleet::{Fleet, LEASE, Plan, SlotKind};
pub use schedule::{Fault, Schedule, Way};
pub use wire::Wire;
