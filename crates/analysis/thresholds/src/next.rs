//! Selects the radii of one ray to run next.
//!
//! A decision is a function of the known outcomes along the ray alone. It may therefore be
//! repeated at any time: requested rollouts are recorded as missing and are not requested
//! again.

use libero_ctrl::Level;
use paired::Outcome;

use crate::found::{Threshold, found};
use crate::ray::Known;
use crate::search::Search;

/// Next step for a ray.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Run these radii; the list is not empty.
    Run(Vec<Level>),
    /// Wait for outcomes.
    Wait,
    /// No radius remains to be run.
    Done,
}

/// Decides which radii of a ray to run.
pub fn next(known: &Known, search: &Search) -> Decision {
    match known.nominal() {
        Outcome::Missing => return Decision::Wait,
        Outcome::Failure | Outcome::Quarantined => return Decision::Done,
        Outcome::Success => {}
    }
    let grid = search.grid.iter().copied();
    let not_run: Vec<Level> = grid.filter(|level| known.at(*level).is_none()).collect();
    if !not_run.is_empty() {
        return Decision::Run(not_run);
    }
    if known
        .points()
        .any(|(_, outcome)| outcome == Outcome::Missing)
    {
        return Decision::Wait;
    }
    let Threshold::Between {
        succeeds_at,
        fails_at,
    } = found(known, search).threshold
    else {
        return Decision::Done;
    };
    match search.halfway([succeeds_at.radius(), fails_at.radius()]) {
        // A rollout exists halfway and did not narrow the bracket, so it is quarantined: the
        // bracket cannot be narrowed further.
        Some(level) if known.at(level).is_none() => Decision::Run(vec![level]),
        _ => Decision::Done,
    }
}
