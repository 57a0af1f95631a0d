//! Specification of a campaign that explains another campaign.

use serde::{Deserialize, Serialize};

/// Parameters of a campaign that explains another campaign: it runs subsets of the axes in
/// configurations whose outcome changed under simultaneous perturbation. The explaining campaign
/// starts without rows, because the subsets follow from the outcomes of both campaigns.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Explanation {
    /// The campaign whose transitions are explained.
    pub campaign: String,
    /// Largest number of rollouts; `None` if every transition is explained.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<u32>,
    /// Seed of the order in which transitions are explained.
    #[serde(default)]
    pub seed: u64,
    /// True if every subset is run, not only the subsets needed to find the minimal subsets.
    #[serde(default)]
    pub exhaustive: bool,
    /// Largest number of replicates that decide whether a subset succeeds, for a policy that
    /// samples; `None` if one rollout decides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<u32>,
}
