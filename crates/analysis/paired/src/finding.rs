//! A finding: a generated sentence of a report and the statistics behind it.

use libero_ctrl::Level;
use serde::{Deserialize, Serialize};

/// Subject of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FindingKind {
    /// Success, nominal and simultaneous.
    Success,
    /// Cost of single axes.
    Cost,
    /// Change by simultaneity beyond chance.
    Simultaneity,
    /// Dependence of success on the direction.
    Directions,
}

/// A generated sentence of a report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// Subject of the sentence.
    pub kind: FindingKind,
    /// Level of the finding; absent for [`FindingKind::Success`], which covers all levels.
    pub level: Option<Level>,
    /// True if the sentence claims an effect.
    pub claims: bool,
    /// The corrected p-value behind the sentence, or the smallest of several; absent if no test is
    /// behind it.
    pub holm_p: Option<f64>,
    /// The sentence.
    pub sentence: String,
}
