//! A worker: pulls jobs from the coordinator, simulates them, asks the policy,
//! reports outcomes.
//!
//! Two kinds of process: [`supervise`] is the parent, which talks to the
//! coordinator and knows no simulator; [`slot`] is a child, which simulates and
//! knows no coordinator. [`rollout`] is what a child does for one job.
//! [`measure`] finds out how many children a machine is worth having.

#![forbid(unsafe_code)]

pub mod actor;
pub mod args;
pub mod assets;
pub mod child;
mod digest;
pub mod film;
mod filming;
mod grpc;
pub mod ids;
pub mod measure;
mod memory;
pub mod message;
mod observation;
pub mod parent;
pub mod policy;
pub mod preview;
pub mod rescue;
pub mod rollout;
pub mod single;
pub mod slot;
pub mod stage;
mod stopwatch;
pub mod supervise;
pub mod variants;
pub mod video;
