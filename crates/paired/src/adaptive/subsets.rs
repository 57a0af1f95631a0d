//! Subsets of the axes that change an outcome, and interactions of the axes.
//!
//! A campaign runs a configuration under each axis alone and under all axes at
//! once. With exact pairing it can run under any other subset as well: six axes
//! have 64 subsets, the *lattice*. From the outcomes of a [`Lattice`], [`explain()`] finds
//! the minimal subsets that explain a transition, [`next()`] and [`plan()`] choose the
//! subsets to run next, and [`Explained`] holds the data of a figure.
//! [`Interactions`] quantifies how the axes interact over configurations whose whole
//! lattice was run.
//!
//! [`explanation`] defines the terms, `next` chooses rollouts for one configuration, and
//! `plan` spends a budget on many.

pub mod explanation;

mod campaign;
mod evidence;
mod interactions;
mod lattice;
mod next;
mod order;
mod plan;
mod proportion;
mod rollouts;
mod summary;

pub use campaign::{configurations, own_configurations};
pub use evidence::{Evidence, Looks, Repeats, Role, Verdict};
pub use explanation::{
    Answer, Explanation, MinimalSubset, NonMonotone, Unexplained, explain, selected,
};
pub use interactions::{CompleteLattice, Estimate, IncompleteLattice, Interactions};
pub use lattice::{Lattice, LatticeError};
pub use next::{Request, Strategy, next};
pub use plan::{Sample, plan};
pub use proportion::clopper_pearson;
pub use rollouts::{Addition, additions, illustrative};
pub use summary::{Explained, Occurrence, SubsetOutcome, occurrences, outcomes};
