//! LIBERO in MuJoCo: compiled scenes, robot controllers, success, offscreen rendering, and the
//! perturbations of LIBERO-CTRL.
//!
//! The behaviour follows hf-libero 0.1.4 with robosuite 1.4.0.
//!
//! All `unsafe` code of the workspace, except a matrix product of `builtin-policies`, is in this crate: in
//! [`mujoco`], in the OpenGL calls and thread-bound values of [`render`], and in the mapping of
//! scene files. It is behind safe types, and every block states why it is sound.

mod compiled_scene;
pub mod controller;
pub mod environment;
pub mod episode;
pub mod error;
mod fingerprint;
#[allow(unsafe_code, reason = "the façade over MuJoCo's C API")]
pub mod mujoco;
pub mod observation;
pub mod perturb;
pub mod predicates;
mod privileged;
mod ready_scene;
pub mod render;
mod reset;
mod scene_files;
pub mod simulator;
mod state;
mod variant;
mod yuv;

pub use compiled_scene::CompiledScene;
pub use controller::ActionFrame;
pub use environment::Environment;
pub use episode::{Conditions, Digests, Episode, Interference};
pub use error::SimError;
pub use fingerprint::fingerprint;
pub use mujoco::{ObjectKind, Segment};
pub use observation::{CameraRequest, Frame, Observation, ObservationRequest, RobotState};
pub use perturb::IkSolution;
pub use ready_scene::{ReadyScene, written_camera};
pub use render::{Drawer, GlDevice, Renderer};
pub use reset::Reset;
pub use scene_files::{SceneFileError, SceneFolder};
pub use simulator::{Simulator, SimulatorConfig};
pub use state::{CapturedView, Snapshot};
pub use variant::{Start, VariantStart};
pub use yuv::bt709;
