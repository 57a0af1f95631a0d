//! Thresholds: the radius at which a policy's success turns to failure.
//!
//! A configuration under one condition has a direction that is the same at every
//! radius: a [`Ray`], which begins at the nominal rollout. From the outcomes that are
//! known along a ray, [`next()`] says which radii to run next and [`found()`] where
//! success turns to failure. A [`Measurement`] puts the rays of a campaign together, and
//! its [`Curve`]s say how many configurations still succeed at a radius.
//!
//! Pure: outcomes go in, decisions and numbers come out, the same for the same outcomes
//! in any order. Read `ray`, `search`, `found`, which says what is known of one
//! ray, then `next`, which chooses radii on it, `measurement`, which spends a budget on many, and `curve`.
//!
//! One rollout decides whether a configuration succeeds at a radius, the one of
//! replicate 0. For a policy that samples, a threshold is therefore that of one draw
//! at each radius, and the curves, which are means over configurations, are what to read.

#![forbid(unsafe_code)]

mod curve;
mod found;
mod measurement;
mod next;
mod ray;
mod search;

pub use curve::{Curve, HalfSuccess, Point};
pub use found::{Found, Threshold, found};
pub use measurement::Measurement;
pub use next::{Decision, next};
pub use ray::{Known, Ray};
pub use search::Search;
