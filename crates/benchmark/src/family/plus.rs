//! LIBERO-Plus: 10,030 variants of LIBERO's forty tasks, each with one change.

mod bddl_path;
mod camera;
mod inventory;
mod problem;
mod prompt;
mod published;
mod start;
mod variant;

pub use bddl_path::{BddlPath, InvalidBddlPath};
pub use camera::{CameraPose, View};
pub use inventory::{Entry, entry, inventory, problem_class};
pub use problem::{Assets, ProblemClass, ProblemError, Style};
pub use prompt::Prompt;
pub use published::{PUBLISHED, Published, SOURCE as PUBLISHED_SOURCE};
pub use start::{ROBOTS, start_posture};
pub use variant::{Change, Dimension, UnknownVariant, Variant};
