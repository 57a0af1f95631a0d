//! A sentence that a report writes by itself, and what it rests on.

use protocol::Level;
use serde::{Deserialize, Serialize};

/// What a finding is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FindingKind {
    /// Success, nominal and simultaneous.
    Success,
    /// What single axes cost.
    Cost,
    /// What simultaneity changes beyond chance.
    Simultaneity,
    /// How success depends on the direction.
    Directions,
}

/// A sentence of a report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// What it is about.
    pub kind: FindingKind,
    /// Of which level; absent of success, which is of all levels.
    pub level: Option<Level>,
    /// Whether it claims an effect.
    pub claims: bool,
    /// The smallest corrected p-value that it rests on; absent where it rests on none.
    pub holm_p: Option<f64>,
    /// The sentence.
    pub sentence: String,
}
