//! Comparison and diagnosis of policy servers that conform to the protocol but whose rollouts fail:
//! the commands `policy-gateway compare` and `policy-gateway doctor`. Both query servers in
//! synthetic or recorded situations and judge only the answers: [`compare`] finds differences
//! between the pipelines of two servers, [`doctor`] finds common mistakes of one server.
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
