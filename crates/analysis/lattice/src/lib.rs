//! Subsets of the axes that change an outcome, and interactions of the axes.
//!
//! A campaign runs a configuration under each axis alone and under all axes at
//! once. A system that pairs exactly can run it under any other subset as well:
//! six axes have 64 subsets, the *lattice*. From the outcomes that are known,
//! [`explain()`] says which minimal subsets explain a transition, [`next()`] and
//! [`plan()`] say which subsets to run next, and [`Explained`] is what a figure
//! draws. Where the whole lattice was run, [`Interactions`] says how the axes
//! interact over all configurations.
//!
//! Pure: outcomes go in, decisions and numbers come out, the same for the same
//! outcomes in any order. Read [`explain`](mod@explain) first: it defines the
//! terms. Then `next`, which chooses rollouts for one configuration, and `plan`,
//! which spends a budget on many.

#![forbid(unsafe_code)]

pub mod explain;

mod campaign;
mod evidence;
mod interactions;
mod known;
mod next;
mod order;
mod plan;
mod proportion;
mod summary;

pub use campaign::{configurations, own_configurations};
pub use evidence::{Evidence, Repeats, Tally, Verdict};
pub use explain::{Answer, Explanation, MinimalSubset, NonMonotone, Unexplained, explain};
pub use interactions::{CompleteLattice, Estimate, IncompleteLattice, Interactions};
pub use known::{Known, KnownError};
pub use next::{Decision, Request, Strategy, next};
pub use plan::{Sample, plan};
pub use proportion::clopper_pearson;
pub use summary::{Explained, Occurrence, SubsetOutcome, occurrences, outcomes};
