//! Comparison and diagnosis of policy servers that keep the protocol and score
//! nothing: the commands `policy-gateway compare` and `policy-gateway doctor`. Both
//! ask servers about situations, made up or recorded, and judge by the answers alone:
//! [`compare`] finds the differences between two servers' pipelines, [`doctor`] the
//! usual mistakes of one.
//!
//! [`situation`] is what is shown, [`made_up`] and [`recorded`] are where it comes
//! from, [`variant`], [`filter`] and [`layout`] how it can be shown otherwise; [`server`] and
//! [`panel`] ask; [`fit`] and [`search`] explain; [`difference`] and [`report`] are
//! the words.

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
