//! A sentence that a report writes by itself, and what it rests on.

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

/// A sentence of a report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// Subject of the sentence.
    pub kind: FindingKind,
    /// Level of the finding; absent of success, which is of all levels.
    pub level: Option<Level>,
    /// True if it claims an effect.
    pub claims: bool,
    /// The smallest corrected p-value that it rests on; absent where it rests on none.
    pub holm_p: Option<f64>,
    /// The sentence.
    pub sentence: String,
}
