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
pub mod backoff;
mod digest;
pub mod film;
pub mod grpc;
pub mod ids;
pub mod measure;
pub mod message;
mod observation;
pub mod policy;
pub mod preview;
mod recording;
pub mod rollout;
pub mod single;
pub mod slot;
pub mod supervise;
pub mod video;
