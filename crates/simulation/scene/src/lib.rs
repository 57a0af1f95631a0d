//! LIBERO scenes as text and numbers: which files a task consists of, what its
//! BDDL file says, the MJCF that robot, arena, fixtures, objects and region
//! sites make together, where the placement samplers put things, and the
//! released initial states.
//!
//! Pure: text in, MJCF out. Nothing here compiles a model or draws a frame;
//! that is crate `sim`. What the original does was read in LIBERO (hf-libero
//! 0.1.4) and robosuite 1.4.0, and is held against their output by
//! `cargo xtask parity`.

#![forbid(unsafe_code)]

pub mod arena;
pub mod bddl;
pub mod catalog;
pub mod compose;
mod element;
pub mod error;
mod expression;
mod family;
#[doc(hidden)]
pub mod fuzzing;
pub mod initial_states;
mod instance;
mod needs;
mod object;
pub mod pack;
mod part;
mod pickle;
pub mod placement;
mod provide;
mod robot;
pub mod rotation;
pub mod sources;
pub mod task;

pub use bddl::Problem;
pub use compose::{Scene, compose};
pub use error::SceneError;
pub use family::fetch_task_files;
pub use initial_states::InitialStates;
pub use instance::{Instance, InstanceKind, RegionSite};
pub use needs::needed_files;
pub use pack::AssetPack;
pub use sources::Sources;
pub use task::TaskFiles;
