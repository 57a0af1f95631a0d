//! A worker as it runs: the real program with real slots, simulating real
//! tasks on the built-in assets, between a scripted coordinator and a policy
//! server that can be told to misbehave.
//!
//! Needs what `cargo xtask setup` unpacks; where that is missing, each test
//! says so and passes.

mod assets;
mod endings;
mod failures;
mod films;
mod leases;
mod machine;
mod outcomes;
mod refusals;
mod scripted_coordinator;
mod scripted_policy;
mod slot_programs;
mod videos;
mod worker_process;
