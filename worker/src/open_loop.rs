//! Actions and description of a policy for measurements: its actions are fixed, and it asks for the
//! same cameras and readings as the published policies.

use benchmark::{ManifestRow, Realisation};
use proto::PROTOCOL_VERSION;
use proto::checks::CAMERAS;
use proto::policy::{CameraRequest, DescribeResponse, StateField};

use crate::actor::{Action, Description};
use crate::ids::random_id;
use crate::message::{Assignment, Session};
use crate::policy::POLICY_CALL_DEADLINE;

/// Side of a frame, pixels.
const FRAME: u32 = 256;
/// Robot readings that the published policies take.
const STATE: [StateField; 3] =
    [StateField::EefPos, StateField::EefAxisAngle, StateField::GripperPos];

/// Returns the action of a control step in the smooth motion of the reference data
/// (docs/dev/FIDELITY.md): a sine per component; the gripper closes after 30 control steps.
pub fn smooth_action(step: usize) -> Action {
    const AMPLITUDE: [f64; 6] = [0.6, 0.6, 0.6, 0.35, 0.35, 0.35];
    const PERIOD: [f64; 6] = [20.0, 30.0, 24.0, 40.0, 36.0, 28.0];
    const PHASE: [f64; 6] = [0.0, 0.7, 1.4, 0.3, 1.1, 2.0];
    let mut action = [0.0; 7];
    for axis in 0..6 {
        let angle = std::f64::consts::TAU * step as f64 / PERIOD[axis] + PHASE[axis];
        action[axis] = AMPLITUDE[axis] * angle.sin();
    }
    action[6] = if step < 30 { -1.0 } else { 1.0 };
    action
}

/// Describes the policy, which sees both cameras every `execute` control steps.
pub fn description(execute: u32) -> Description {
    let camera = |name: &str| CameraRequest { name: name.to_owned(), width: FRAME, height: FRAME };
    Description {
        about: DescribeResponse {
            protocol_version: PROTOCOL_VERSION,
            name: "open-loop".to_owned(),
            cameras: CAMERAS.map(camera).to_vec(),
            horizon: execute,
            execute,
            ..DescribeResponse::default()
        },
        state: STATE.to_vec(),
        horizon: execute as usize,
        execute: execute as usize,
    }
}

/// Builds an assignment without video or stored actions.
pub fn assignment(row: ManifestRow) -> Assignment {
    let attempt = random_id();
    Assignment {
        attempt,
        policy: "open-loop".to_owned(),
        policy_endpoint: String::new(),
        policy_seed: 0,
        policy_deadline: POLICY_CALL_DEADLINE,
        session: Session::new(&row.id, 0, attempt),
        realisation: Realisation::Matched,
        video: None,
        keep_actions: false,
        row,
    }
}
