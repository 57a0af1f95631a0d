//! Matched-outcome statistics: compares outcomes of the same configurations under each axis alone
//! and under all axes at once. Computes the rate and direction of the outcome changes that
//! simultaneous perturbation causes, and the difference of two policies over the same rollouts,
//! with confidence intervals. Intervals for a campaign that may end early are in the file
//! `sequential`.
//!
//! The crate does no I/O: a [`Report`] is a function of the set of records, whose
//! order does not matter. The caller passes warnings about the origin of the
//! records in [`Options::notes`]. Formulas: section 6 of the protocol; source of
//! the design: arXiv 2609.15940.

#![forbid(unsafe_code)]

pub mod adaptive;
mod bootstrap;
mod bounds;
mod comparison;
mod design;
mod difference;
mod evaluate;
mod findings;
mod gate;
mod inference;
mod measures;
mod outcomes;
mod progress;
mod replication;
mod report;
mod sequential;
mod text;

pub use bootstrap::{Bootstrap, Interval, MIN_TASKS, NoInterval, intervals_of_many, quantile};
pub use bounds::Bounds;
pub use comparison::{Compared, ComparedCell, Comparison, Obstacle};
pub use design::{Detectable, task_correlation};
pub use difference::{Difference, DifferenceBounds, Pair, Profile};
pub use evaluate::{report, report_of};
pub use findings::{FINDING_ALPHA, Finding, FindingKind, findings};
pub use gate::{
    GATE_ROLLOUTS, GATE_ROLLOUTS_OF_A_SUITE, GATE_TOLERANCE, Gate, GateVerdict, SuiteGate,
};
pub use inference::Inference;
pub use inference::direction::DirectionTest;
pub use inference::estimate::{Estimate, FEWEST_TASKS};
pub use inference::floor::{Excess, Simultaneity, chance_bounds};
pub use inference::hypotheses::{
    EQUIVALENCE_MARGIN, equivalence_p, holm, max_t, mcnemar_exact, sign_flip_p,
};
pub use inference::loss::{Loss, Losses};
pub use inference::paired::{Eligible, PairedEstimates, Relative};
pub use measures::{Configuration, Measures};
pub use outcomes::{Count, DuplicateRecord, Matched, Outcome, Record, Records, Transition};
pub use progress::{MeanDifference, Progress, ProgressDifference};
pub use replication::{Components, Flips};
pub use report::{
    Cell, Completeness, Gap, Nominal, NominalSource, Options, Report, SingleAxis, SuiteRow,
    TaskSuccess,
};
pub use sequential::{
    Bisection, CampaignLook, ConditionEvidence, Drawn, Look, NonInferiority, Order, RateInterval,
    SEQUENTIAL_ALPHA, SequentialMeasures, Unit, Verdict, drawn_order,
};
