//! Thresholds: the radius at which a policy's success turns to failure.
//!
//! A configuration under one condition has the same direction at every radius: a
//! [`Ray`], which begins at the nominal rollout. From the outcomes along a ray,
//! [`next()`] chooses the radii to run next and [`Finding`] derives the threshold. A
//! [`Measurement`] collects the rays of a campaign, and its [`Curve`]s give the share of
//! configurations that still succeed at a radius.
//!
//! `ray`, `search` and `threshold` describe a single ray, `next` chooses radii on it,
//! `measurement` spends a budget on many, and `curve` summarises them.
//!
//! Only the rollout of replicate 0 decides whether a configuration succeeds at a radius.
//! For a policy that samples, a threshold therefore rests on one draw per radius; the
//! curves, which are means over configurations, remain meaningful.

mod curve;
mod measurement;
mod next;
mod ray;
mod search;
mod threshold;

pub use curve::{Curve, HalfSuccess, Point};
pub use measurement::Measurement;
pub use next::next;
pub use ray::Ray;
pub use search::Search;
pub use threshold::{Finding, Threshold};
