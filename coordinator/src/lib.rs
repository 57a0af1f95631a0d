//! Serves the queue: workers and operators call it (`grpc`), browsers show it
//! (`page`), reports and exports read it. What is leased, stored and decided is
//! the business of [`queue`]. It knows no simulator and no policy. The command
//! line is the program's business.

#![forbid(unsafe_code)]

mod access;
pub mod archive;
pub mod client;
pub mod disk;
pub mod export;
pub mod forecast;
mod gauges;
mod grpc;
mod mirror;
mod page;
pub mod reading;
pub mod report;
mod serve;
pub mod storage;
pub mod video_estimate;
pub mod words;

pub use serve::{Config, Coordinator, ServeError};
