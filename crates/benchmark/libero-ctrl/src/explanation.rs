//! Specification of a campaign that explains another one.

use serde::{Deserialize, Serialize};

/// Parameters of a campaign that explains another one: it runs subsets of the axes in
/// configurations whose outcome changed under simultaneous perturbation. The subsets
/// follow from the outcomes of both campaigns, so that it starts without rows.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Explanation {
    /// The campaign whose transitions are explained.
    pub campaign: String,
    /// Largest number of rollouts; without it, every transition is explained.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<u32>,
    /// Seed of the order in which transitions are explained.
    #[serde(default)]
    pub seed: u64,
    /// True if every subset is run, not only those needed to find the minimal ones.
    #[serde(default)]
    pub exhaustive: bool,
    /// Largest number of replicates that decide whether a subset succeeds, for a policy that
    /// samples. Without it, one rollout decides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<u32>,
}
