//! Identifiers, each with a type of its own, so that a job number is never taken for an attempt
//! number, nor a worker's id for a campaign's name. The benchmark's `RolloutId` names rollouts.

use std::fmt;

use benchmark::JsonError;
pub use benchmark::attempt::shortened;
use serde::{Deserialize, Serialize};

/// Longest name of a campaign, bytes. A campaign's name is also the name of a folder.
pub const MAX_CAMPAIGN_NAME_BYTES: usize = 80;
/// Longest worker id, bytes.
pub const MAX_WORKER_ID_BYTES: usize = 128;
/// Longest problem of a JSON text in a message, bytes.
const MAX_PROBLEM_BYTES: usize = 200;

/// Row number of a campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, sqlx_macros::Type)]
#[sqlx(transparent)]
pub struct CampaignId(pub i64);

/// Row number of a job: one rollout × replicate of one campaign.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Serialize,
    Deserialize,
    sqlx_macros::Type,
)]
#[sqlx(transparent)]
pub struct JobId(pub i64);

/// Row number of a policy at one endpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, sqlx_macros::Type)]
#[sqlx(transparent)]
pub struct PolicyId(pub i64);

/// Number of times that a job has been leased; 0 before the first lease, never decreasing. An
/// attempt is identified by its `AttemptId`, not by this number.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Serialize,
    Deserialize,
    sqlx_macros::Type,
)]
#[sqlx(transparent)]
pub struct AttemptNumber(pub u32);

/// Id of a worker process, chosen by the worker when it starts.
#[derive(
    Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, sqlx_macros::Type,
)]
#[sqlx(transparent)]
pub struct WorkerId(pub String);

/// Name of a campaign: letters, digits, `-`, `_` and `.`, not starting with a
/// dot, so that it can name a folder anywhere.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, sqlx_macros::Type)]
#[sqlx(transparent)]
pub struct CampaignName(String);

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JobName {
    pub rollout_id: String,
    pub replicate: u32,
}

/// A name that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    #[error(
        "read campaign name {name:?}: use 1 to {MAX_CAMPAIGN_NAME_BYTES} letters, digits, `-`, `_` and `.`, not starting with a dot"
    )]
    Campaign { name: String },
    #[error(
        "read worker id `{id}`: use 1 to {MAX_WORKER_ID_BYTES} visible ASCII characters without spaces"
    )]
    Worker { id: String },
}

impl CampaignName {
    pub fn parse(name: &str) -> Result<CampaignName, NameError> {
        let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        let fits = (1..=MAX_CAMPAIGN_NAME_BYTES).contains(&name.len());
        if fits && !name.starts_with('.') && name.chars().all(allowed) {
            Ok(CampaignName(name.to_owned()))
        } else {
            Err(NameError::Campaign { name: shortened(name, MAX_CAMPAIGN_NAME_BYTES).to_owned() })
        }
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl WorkerId {
    pub fn parse(id: &str) -> Result<WorkerId, NameError> {
        let fits = (1..=MAX_WORKER_ID_BYTES).contains(&id.len());
        if fits && id.chars().all(|c| c.is_ascii_graphic()) {
            Ok(WorkerId(id.to_owned()))
        } else {
            Err(NameError::Worker { id: shortened(id, MAX_WORKER_ID_BYTES).to_owned() })
        }
    }
}

macro_rules! impl_display {
    ($($name:ty),*) => {
        $(impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        })*
    };
}
impl_display!(CampaignName, WorkerId, JobId, AttemptNumber);

impl fmt::Display for JobName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.replicate {
            0 => f.write_str(&self.rollout_id),
            replicate => write!(f, "{}#r{replicate}", self.rollout_id),
        }
    }
}

/// Returns the problem of a JSON text, shortened, since the parser may quote the text.
pub fn json_problem(error: serde_json::Error) -> String {
    shortened(JsonError::from(error).problem(), MAX_PROBLEM_BYTES).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_campaign_name_cannot_be_a_path_or_a_hidden_file() {
        for invalid in ["", ".", "..", "../up", "a/b", "a\\b", "a b", "é", ".hidden"] {
            assert!(CampaignName::parse(invalid).is_err(), "{invalid:?}");
        }
        assert!(CampaignName::parse(&"x".repeat(MAX_CAMPAIGN_NAME_BYTES + 1)).is_err());
        assert!(CampaignName::parse("pi05_L1.v2-final").is_ok());
    }
}
