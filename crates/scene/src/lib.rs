//! LIBERO scenes as data: files of a task, BDDL problems, composition of robot, arena, fixtures,
//! objects and region sites into MJCF, placement samplers, and the released initial states.
//!
//! Text in, MJCF out: this crate neither compiles a model nor renders a frame; crate `sim` does.
//! The behaviour follows LIBERO (hf-libero 0.1.4) with robosuite 1.4.0. `cargo xtask parity`
//! compares scenes and simulations with theirs.

#![forbid(unsafe_code)]

pub mod arena;
pub mod assets;
pub mod bddl;
pub mod catalog;
pub mod compose;
mod element;
pub mod error;
mod expression;
mod family;
#[doc(hidden)]
pub mod fuzzing;
mod goal;
pub mod initial_states;
mod object;
pub mod pack;
mod paraphrases;
mod part;
mod pickle;
pub mod placement;
mod provide;
mod robot;
pub mod rotation;
pub mod sources;
pub mod task;

pub use bddl::Problem;
pub use compose::{Instance, InstanceKind, RegionSite, Scene, compose};
pub use error::SceneError;
pub use family::{fetch_task_files, has_task_files};
pub use goal::check_goal;
pub use initial_states::InitialStates;
pub use pack::AssetPack;
pub use paraphrases::copy_paraphrases;
pub use provide::needed_files;
pub use sources::Sources;
pub use task::{FileStamps, TaskFiles};
