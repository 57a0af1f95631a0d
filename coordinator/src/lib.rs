//! The campaign's memory: expands campaigns into jobs, leases them to workers,
//! keeps their outcomes with everything that made them. It knows no simulator
//! and no policy.
//!
//! Requests come in through `grpc`; [`queue`] reads the state, lets the pure
//! modules ([`lease`], [`outage`], [`plan`]) decide, and executes through
//! [`store`]. `page` shows it all to browsers. What people type is the program's
//! business.

#![forbid(unsafe_code)]

pub mod artifacts;
pub mod campaign;
pub mod client;
pub mod clock;
pub mod digests;
pub mod disk;
pub mod expand;
pub mod export;
mod grpc;
pub mod ids;
pub mod invariants;
pub mod lease;
pub mod outage;
mod page;
mod pairing;
pub mod plan;
pub mod queue;
pub mod report;
mod serve;
pub mod store;
pub mod video_estimate;
pub mod words;

pub use serve::{Config, Coordinator, ServeError, run};
