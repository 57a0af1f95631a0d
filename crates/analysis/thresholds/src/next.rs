//! Selects the radii of one ray to run next.
//!
//! A decision is a function of what is known along the ray, of nothing else. So it may
//! be made at any time and as often as one likes: what was asked for is known as
//! missing, and is not asked for again.

use libero_ctrl::Level;
use paired::Outcome;

use crate::found::{Threshold, found};
use crate::ray::Known;
use crate::search::Search;

/// Brackets are as wide as they were asked for if they exceed it by a rounding error
/// only: radii have six decimals.
const ROUNDING: f64 = 1e-5;

/// Next step for a ray.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Run these radii; there is one at least.
    Run(Vec<Level>),
    /// Wait for outcomes.
    Wait,
    /// There is nothing more to be run.
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
    let [low, high] = [succeeds_at.radius(), fails_at.radius()];
    let is_wide = search
        .tolerance
        .is_some_and(|it| high - low > it + ROUNDING);
    let halfway = Level::of_radius(f64::midpoint(low, high)).filter(|_| is_wide);
    match halfway {
        // A known outcome halfway is in quarantine: the bracket stays as wide as it
        // is.
        Some(level) if known.at(level).is_none() => Decision::Run(vec![level]),
        _ => Decision::Done,
    }
}
