//! Specification of a campaign that explains another one.

use serde::{Deserialize, Serialize};

/// A campaign that explains another one runs subsets of the axes in
/// configurations whose outcome simultaneous perturbation changed. Which
/// subsets follows from the outcomes of both campaigns, so that it has no rows
/// of its own to begin with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Explanation {
    /// The campaign whose transitions are explained.
    pub campaign: String,
    /// Most rollouts; without it, every transition is explained.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<u32>,
    /// Seed of the order in which transitions are explained.
    #[serde(default)]
    pub seed: u64,
    /// True if every subset is run, and not only those that decide which of them
    /// are minimal.
    #[serde(default)]
    pub exhaustive: bool,
    /// Most replicates, for a policy that samples, by which it is decided whether
    /// a subset succeeds. Without it, one rollout decides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<u32>,
}
