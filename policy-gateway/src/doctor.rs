//! Examination of policy servers, for the commands `check`, `compare` and `doctor` of
//! `policy-gateway`. [`conformance`] checks that a server conforms to the policy protocol. The
//! other modules are for conforming servers whose rollouts fail: [`compare`] finds differences
//! between the pipelines of two servers, and [`diagnosis`] finds common mistakes of one server.
//! These two query servers in synthetic or recorded situations, without a simulator.
//!
//! `situation` is the input of a query, from [`synthetic`] or `recorded`; `variant`, `filter` and
//! `layout` modify it; [`server`] and `server_pair` send queries; `fit` and `search` explain
//! differences; [`difference`] and `report` write the results as text and JSON.

mod answers;
pub mod command;
pub mod compare;
pub mod conformance;
mod descriptions;
pub mod diagnosis;
pub mod difference;
mod filter;
mod fit;
mod layout;
pub mod looks;
pub mod pose;
mod randomness;
mod recorded;
mod report;
mod search;
pub mod server;
mod server_pair;
pub mod situation;
pub mod synthetic;
mod variant;
pub mod verdict;
