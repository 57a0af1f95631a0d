//! The policy of a campaign, and the selection of rollouts to record on video.

use serde::{Deserialize, Serialize};

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyRoute {
    /// Name of the policy at the endpoint.
    pub name: String,
    /// URL of the gateway, or of the policy itself.
    pub endpoint: String,
}

/// Selection of the rollouts to record on video.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Record {
    /// No rollout.
    #[default]
    None,
    /// Rollouts that fail.
    Failures,
    /// Rollouts of configurations whose outcome changes under simultaneous perturbation,
    /// and their nominal rollouts; replayed afterwards from the actions stored with every
    /// rollout.
    Transitions,
    /// Every rollout.
    All,
}
