//! LIBERO-Plus: 10,030 variants of LIBERO's forty tasks, each with one change.

mod camera;
mod inventory;
mod problem;
mod prompt;
mod start;
mod variant;

pub use camera::{CameraPose, View};
pub use inventory::{Entry, entry, inventory};
pub use problem::{Assets, ProblemClass, ProblemError, Style};
pub use prompt::Prompt;
pub use start::{ROBOTS, start_posture};
pub use variant::{Change, Dimension, UnknownVariant, Variant};
