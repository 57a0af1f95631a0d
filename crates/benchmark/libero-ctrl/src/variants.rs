//! Specification of a campaign of LIBERO's family: the selection of variants, by name. The names
//! are checked by `libero-family`, which expands them into rows.

use serde::{Deserialize, Serialize};

use crate::benchmark::Benchmark;
use crate::condition::Realisation;
use crate::execution::Execution;
use crate::policy_route::Record;

/// Variants of a benchmark under one protocol, each with the unperturbed rollout of its task. A
/// variant must match all filters that are given.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Variants {
    pub benchmark: Benchmark,
    /// Name of the protocol. Rollouts of two protocols are never pooled.
    pub protocol: String,
    /// Names of variants of LIBERO-Plus; empty for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub variants: Vec<String>,
    /// Suites: LIBERO's for LIBERO-Plus, LIBERO-PRO's for LIBERO-PRO; empty for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub suites: Vec<String>,
    /// Dimensions of LIBERO-Plus; empty for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dimensions: Vec<String>,
    /// Difficulties of LIBERO-Plus, 1 to 5, and 0 for variants without a difficulty; empty for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub difficulties: Vec<u8>,
    /// Types of paraphrase of LIBERO-Para, or names of its sentences; empty for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub paraphrases: Vec<String>,
    /// Tasks of LIBERO-Para, such as `libero_goal/8`; empty for all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tasks: Vec<String>,
    /// Number of trials of each task of LIBERO-PRO, from the first initial states; `None` for all
    /// fifty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trials: Option<u16>,
    /// True if variants that no worker can run are left out.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub runnable: bool,
}

/// A field of a specification that its variants or its suite file exclude.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{field}` beside `{rollouts}`: {problem}")]
pub struct VariantsError {
    pub field: &'static str,
    /// Field that defines the rollouts, `variants` or `suite_file`.
    pub rollouts: &'static str,
    pub problem: &'static str,
}

impl VariantsError {
    /// Returns the error for the first field that a specification with `rollouts` (`variants` or
    /// `suite_file`) must not have; `None` if all are allowed.
    pub(crate) fn excluded(
        rollouts: &'static str,
        realisation: Realisation,
        replicates: u32,
        record: Record,
        execution: &Execution,
        has_stop_rule: bool,
    ) -> Option<Self> {
        let rules = [
            (
                "realisation",
                realisation != Realisation::Matched,
                "the rollouts have no random elements of LIBERO-CTRL's axes; write matched",
            ),
            ("replicates", replicates > 1, "its protocol runs each rollout once; write 1"),
            (
                "record",
                record == Record::Transitions,
                "the rollouts have no simultaneous perturbation; write none, failures or all",
            ),
            (
                "stop",
                has_stop_rule,
                "stop rules use LIBERO-CTRL's measures, which the rollouts lack; leave it out",
            ),
            (
                "execution",
                !execution.is_wait(),
                "its protocol pauses the simulation during inference; leave it out",
            ),
        ];
        let mut rules = rules.into_iter();
        let (field, _, problem) = rules.find(|(_, is_refused, _)| *is_refused)?;
        Some(Self { field, rollouts, problem })
    }
}
