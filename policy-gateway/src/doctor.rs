//! Examination of policy servers of `rollout.policy.v1` by synthetic observations, without a
//! simulator. [`check`] checks that a server conforms to the policy protocol, and looks for usual
//! mistakes; [`compare`] explains how the answers of two servers differ.
//!
//! `synthetic` generates the situations, `probe` queries a server in them. `verdict` and `mistakes`
//! judge answers to a check. For a comparison, `variant` and `layout` modify observations, `fit`
//! and `search` explain differences, [`difference`] and [`report`] put them into words.

mod answers;
pub mod check;
pub mod compare;
pub mod difference;
mod fit;
pub mod latency;
mod layout;
mod mistakes;
pub mod pose;
pub mod probe;
mod randomness;
pub mod report;
mod search;
mod server_pair;
pub mod synthetic;
mod variant;
pub mod verdict;
