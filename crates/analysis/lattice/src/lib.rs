//! Subsets of the axes that change an outcome, and interactions of the axes.
//!
//! A campaign runs a configuration under each axis alone and under all axes at
//! once. With exact pairing it can run under any other subset as well: six axes
//! have 64 subsets, the *lattice*. From the known outcomes, [`explain()`] finds the
//! minimal subsets that explain a transition, [`next()`] and [`plan()`] choose the
//! subsets to run next, and [`Explained`] holds the data of a figure.
//! [`Interactions`] quantifies how the axes interact over configurations whose whole
//! lattice was run.
//!
//! The crate does no I/O: decisions and numbers are functions of the set of
//! outcomes, whose order does not matter. [`explain`](mod@explain) defines the
//! terms, `next` chooses rollouts for one configuration, and `plan` spends a budget
//! on many.

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
pub use evidence::{Evidence, Looks, Repeats, Role, Tally, Verdict};
pub use explain::{
    Answer, Explanation, MinimalSubset, NonMonotone, Unexplained, explain, selected,
};
pub use interactions::{CompleteLattice, Estimate, IncompleteLattice, Interactions};
pub use known::{Known, KnownError};
pub use next::{Decision, Request, Strategy, next};
pub use plan::{Sample, plan};
pub use proportion::clopper_pearson;
pub use summary::{Explained, Occurrence, SubsetOutcome, occurrences, outcomes};
