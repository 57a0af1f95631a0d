//! Adaptive searches: the outcomes of one campaign, the *source*, give rise to a search,
//! and a second campaign runs the rollouts that the search requests.
//!
//! [`subsets`] finds the subsets of the axes that flip a configuration's outcome, and
//! [`radii`] the radius at which success turns to failure, along the ray of radii of one
//! configuration under one condition. A search has points: subsets, or radii. [`Outcomes`] holds
//! the outcomes of both campaigns by point, and each search has a function `next` that returns a
//! [`Decision`].
//!
//! Decisions and numbers are functions of the set of outcomes, whose order does not matter. Nothing
//! is kept between calls, so that a decision may be repeated at any time: a rollout that the caller
//! records as missing is not requested again.

pub mod radii;
pub mod subsets;

mod decision;
mod outcomes;
mod source;

pub use decision::Decision;
pub use outcomes::{Outcomes, Tally};
