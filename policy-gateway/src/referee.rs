//! Comparison and diagnosis of policy servers that conform to the protocol but score nothing: the
//! commands `policy-gateway compare` and `policy-gateway doctor`. Both query servers in synthetic
//! or recorded situations, and judge by the answers alone: [`compare`] finds the differences
//! between two servers' pipelines, [`doctor`] the usual mistakes of one.
//!
//! [`situation`] is the input of a query, from [`made_up`] or [`recorded`]; [`variant`],
//! [`filter`] and [`layout`] modify it; [`server`] and [`panel`] send queries; [`fit`] and
//! [`search`] explain differences; [`difference`] and [`report`] put them into words.

pub mod answers;
pub mod chance;
pub mod command;
pub mod compare;
pub mod descriptions;
pub mod difference;
pub mod doctor;
pub mod filter;
pub mod fit;
pub mod layout;
pub mod made_up;
pub mod panel;
pub mod pose;
pub mod recorded;
pub mod report;
pub mod search;
pub mod server;
pub mod situation;
pub mod variant;
