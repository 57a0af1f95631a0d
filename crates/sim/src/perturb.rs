//! The five metric axes of the protocol as pure arithmetic on values of a scene, a picture or an
//! action.
//!
//! The module neither accesses MuJoCo models nor renders. Parameters come from the manifest row,
//! and random elements from [`benchmark::streams`]. `docs/PROTOCOL.md` defines the effect of each
//! axis and the step of a rollout at which it acts.

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
