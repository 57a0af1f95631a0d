//! Server of the rollout queue: gRPC services for workers and operators (`grpc`), pages for
//! browsers (`page`), reports, exports and archives; and the client of these services (`client`).
//! `storage` keeps films outside the data folder, and `mirror` moves them there. Leasing, storage
//! and scheduling decisions are in [`queue`], the command line is in the binary. This crate depends
//! on no simulator and no policy.

#![forbid(unsafe_code)]

mod access;
pub mod archive;
pub mod client;
pub mod disk;
pub mod export;
mod gauges;
mod grpc;
mod mirror;
mod page;
pub mod reading;
mod serve;
pub mod storage;
mod subject;
pub mod video_estimate;
pub mod words;

pub use serve::{Config, Coordinator, ServeError};
