//! LIBERO-CTRL as data and pure functions: suites, axes, presets, manifests,
//! rollout ids, seeds and the streams from which perturbations are drawn.
//!
//! The crate opens no file, reads no clock and does not depend on a simulator.
//!
//! In this crate, *the protocol* is LIBERO-CTRL v0.1 as published (arXiv 2609.15940), and *the
//! reference* or *reference implementation* is the protocol's released code, whose manifests, ids
//! and seeds are reproduced here.

#![forbid(unsafe_code)]

pub mod attempt;
pub mod family;
pub mod manifest;
pub mod numpy;
pub mod presets;
pub mod seeds;
pub mod streams;

mod axis;
mod axis_set;
mod benchmark;
mod campaign;
mod condition;
mod design;
mod design_version;
mod directions;
mod execution;
mod expansion;
mod latency;
mod level;
mod look;
mod measurable;
mod names;
mod own_task;
mod paraphrase;
mod perturbation;
mod privileged;
mod rollout_id;
mod row;
mod schedule;
mod simulated;
mod spec_error;
mod stop;
mod stop_rule;
mod suite;
mod suite_file;
mod task_key;
mod thresholds;
mod variant_name;
mod wanted;
mod wording;

pub use axis::{AXES, ActsOn, Axis, AxisDef, Radii};
pub use axis_set::AxisSet;
pub use benchmark::Benchmark;
pub use campaign::{CampaignSpec, Explanation, PolicyRoute, Purpose, Record, Rollouts};
pub use condition::{Condition, PUBLISHED, Realisation};
pub use design::{Design, DesignError, Nominal, PLACEBO_RADII, Placebo, select_tasks};
pub use design_version::DesignVersion;
pub use directions::{Directions, MAX_CONFIGS};
pub use execution::{
    CONTROL_HZ, Delays, Execution, ExecutionError, LatencyFileError, MAX_DELAY, TooLate,
};
pub use expansion::{NoSuchRow, row_of};
pub use latency::{STEPS_PER_RADIUS, delay_at, execution_at};
pub use level::Level;
pub use look::Look;
pub use measurable::NotMeasurable;
pub use names::UnknownName;
pub use own_task::{Beginning, Changes, InvalidField, OwnTask};
pub use paraphrase::{Paraphrase, paraphrase};
pub use perturbation::*;
pub use privileged::{Entity, EntityKind, Predicate, Privileged};
pub use rollout_id::RolloutId;
pub use row::{MAX_ROWS, ManifestRow, RowError};
pub use schedule::{ACTION_WIDTH, Action, Command, Query, Schedule};
pub use simulated::{Parameters, SimulatedTask};
pub use spec_error::{MAX_REPLICATES, SpecError};
pub use stop::{Stop, StopError, Strata};
pub use stop_rule::{Clause, Measure, StopRule};
pub use suite::{INIT_STATES_PER_TASK, Suite, TASKS_PER_SUITE, TaskRef};
pub use suite_file::{FileSuite, FileTask, SuiteFile, SuiteFileError, SuitePrompt};
pub use task_key::TaskKey;
pub use thresholds::{MAX_RADII, TOLERANCES, Thresholds};
pub use variant_name::VariantName;
pub use wanted::{RendererKind, Wanted};
pub use wording::{JsonError, plain_words};
