//! The five metric axes of the protocol as arithmetic: numbers of a scene, a
//! picture or an action go in, perturbed ones come out.
//!
//! Not responsible for reading or writing a MuJoCo model, for rendering, or for
//! the size of a perturbation: the values come from the manifest row, and the
//! random elements from [`libero_ctrl::streams`]. Section 4 of the protocol says
//! what each axis does, and when in a rollout.

mod actuation;
mod camera;
mod dct;
mod jpeg;
mod lighting;
mod robot;
mod sensor;

pub use actuation::ActuationStage;
pub use camera::{CameraPose, look_at_point, shift_camera};
pub use lighting::{Light, Lighting, shift_lighting};
pub use robot::{
    ArmState, IkSolution, JOINTS, Jacobian, JointRange, JointVector, solve_shifted_pose,
};
pub use sensor::{Frame, FrameSource, SensorStage};
