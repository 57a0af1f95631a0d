//! A worker: leases jobs from the coordinator, simulates them, queries the policy and reports
//! outcomes.
//!
//! There are two kinds of process: [`supervise`] is the parent, which calls the coordinator and
//! has no simulator; [`slot`] is a child, which simulates and has no connection to the
//! coordinator. [`rollout`] runs one job in a child. [`slots`] limits the number of children.

#![forbid(unsafe_code)]

pub mod actor;
pub mod args;
pub mod assets;
pub mod child;
pub mod film;
mod filming;
mod grpc;
pub mod ids;
mod memory;
pub mod message;
mod observation;
pub mod open_loop;
pub mod parent;
mod picture;
pub mod pipe;
pub mod policy;
pub mod preview;
pub mod rescue;
pub mod rollout;
mod simulated;
pub mod single;
pub mod slot;
pub mod slots;
pub mod stage;
mod stopwatch;
pub mod supervise;
pub mod variants;
pub mod video;
