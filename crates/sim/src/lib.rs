//! LIBERO in MuJoCo: compiled scenes, the robot's controllers, success, frames
//! drawn off-screen, and the perturbations of LIBERO-CTRL.
//!
//! The only crate of the workspace with `unsafe` code: in [`mujoco`], and in
//! [`render`] where it calls OpenGL, behind safe types, with a reason at every
//! block.

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
pub mod simulator;

pub use environment::Environment;
pub use episode::{Digests, Episode};
pub use error::SimError;
pub use fingerprint::fingerprint;
pub use mujoco::Segment;
pub use observation::{
    CameraRequest, Entity, EntityKind, Frame, Observation, ObservationRequest, Privileged,
    RobotState,
};
pub use perturb::IkSolution;
pub use render::{Drawer, GlDevice, Renderer};
pub use reset::Reset;
pub use simulator::{Simulator, SimulatorConfig};
