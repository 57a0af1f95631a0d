//! The real worker program with real slots, which simulate real tasks with the built-in assets,
//! between a scripted coordinator and a policy server that misbehaves on demand. They need the files
//! that `cargo xtask setup` unpacks.

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
