//! Selects the radii of one ray to run next.

use crate::Outcome;
use benchmark::Level;

use super::search::Search;
use super::threshold::{Finding, Threshold};
use crate::adaptive::decision::Decision;
use crate::adaptive::outcomes::Outcomes;

/// Decides which radii of a ray to run, from the outcomes along it alone.
pub fn next(outcomes: &Outcomes<Level>, search: &Search) -> Decision<Level> {
    match outcomes.nominal() {
        Outcome::Missing => return Decision::Wait,
        Outcome::Failure | Outcome::Quarantined => return Decision::Done,
        Outcome::Success => {}
    }
    let grid = search.grid.iter().copied();
    let not_run: Vec<Level> = grid.filter(|level| outcomes.at(*level).is_none()).collect();
    if !not_run.is_empty() {
        return Decision::Run(not_run);
    }
    let is_missing = |(_, outcome)| outcome == Outcome::Missing;
    if outcomes.perturbed().any(is_missing) {
        return Decision::Wait;
    }
    let halfway = match Finding::new(outcomes, search).threshold {
        Threshold::Between { succeeds_at, fails_at } => {
            search.halfway([succeeds_at.radius(), fails_at.radius()])
        }
        _ => None,
    };
    // If a rollout exists halfway and did not narrow the bracket, it is quarantined: the bracket
    // cannot be narrowed further.
    let not_run = halfway.filter(|level| outcomes.at(*level).is_none());
    Decision::run(not_run.into_iter().collect())
}
