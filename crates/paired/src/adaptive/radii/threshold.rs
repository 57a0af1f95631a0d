//! Threshold of one ray, derived from its known outcomes.

use crate::Outcome;
use benchmark::Level;

use super::search::Search;
use crate::adaptive::outcomes::Outcomes;

/// Radius at which success turns to failure, as far as known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Threshold {
    /// The nominal rollout fails, so that there is no threshold.
    NominalFails,
    NominalUnknown,
    /// The threshold lies between the smallest failing radius and the largest successful
    /// radius below it.
    Between {
        /// Largest successful radius below `fails_at`; L0 is the nominal rollout.
        succeeds_at: Level,
        fails_at: Level,
    },
    /// The largest radius of the grid succeeds and no radius is known to fail: the threshold is
    /// right-censored at the largest radius.
    Beyond,
    /// No radius is known to fail, and the largest radius has no outcome: the threshold is
    /// right-censored at the largest radius that is known to succeed.
    Open {
        /// Largest radius that is known to succeed; L0 is the nominal rollout.
        succeeds_at: Level,
    },
}

/// Threshold of a ray, as far as its outcomes determine it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The first radius at which success turns to failure.
    pub threshold: Threshold,
    /// Radii beyond the threshold that succeed, so that the ray is not monotone.
    pub recovers_at: Vec<Level>,
    /// True if the nominal rollout fails, or if it succeeds and no rollout of the grid is missing.
    /// A missing rollout may turn out to fail at a smaller radius.
    pub is_grid_complete: bool,
}

impl Finding {
    pub fn new(outcomes: &Outcomes<Level>, search: &Search) -> Self {
        let largest = search.largest().unwrap_or(Level::L0);
        let fails_at = outcomes.levels(false).find(|level| *level <= largest);
        let threshold = match (outcomes.nominal(), fails_at) {
            (Outcome::Failure, _) => Threshold::NominalFails,
            (Outcome::Missing | Outcome::Quarantined, _) => Threshold::NominalUnknown,
            (Outcome::Success, Some(fails_at)) => {
                let mut below = outcomes.levels(true).rev().filter(|level| *level < fails_at);
                Threshold::Between { succeeds_at: below.next().unwrap_or(Level::L0), fails_at }
            }
            (Outcome::Success, None) => {
                match search.largest().and_then(|level| outcomes.at(level)?.success()) {
                    Some(_) => Threshold::Beyond,
                    None => Threshold::Open {
                        succeeds_at: outcomes
                            .levels(true)
                            .rfind(|level| *level <= largest)
                            .unwrap_or(Level::L0),
                    },
                }
            }
        };
        let first_failure = match threshold {
            Threshold::NominalFails => Some(Level::L0),
            Threshold::Between { fails_at, .. } => Some(fails_at),
            _ => None,
        };
        let recovers_at = first_failure.map(|failure| {
            let levels = outcomes.levels(true).filter(|level| *level <= largest);
            levels.filter(|level| *level > failure).collect()
        });
        let is_missing =
            |level: &Level| outcomes.at(*level).unwrap_or_default() == Outcome::Missing;
        Self {
            threshold,
            recovers_at: recovers_at.unwrap_or_default(),
            is_grid_complete: match threshold {
                Threshold::NominalFails => true,
                Threshold::NominalUnknown => false,
                _ => !search.grid.iter().any(is_missing),
            },
        }
    }
}
