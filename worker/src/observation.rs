//! Converts the simulator's observations to the policy protocol. Orientation, units and coordinate
//! frames stay as they are.

use benchmark::{Entity, EntityKind, Predicate, Privileged};
use proto::policy as wire;
use sim::{Frame, Observation, RobotState};
use wire::StateField;

/// Converts an observation, with the readings that the policy asked for, in the policy's order.
pub(crate) fn to_wire(observation: Observation, state: &[StateField]) -> wire::Observation {
    let robot = observation.robot;
    wire::Observation {
        images: observation.frames.into_iter().map(image).collect(),
        state: state
            .iter()
            .map(|&field| wire::StateReading {
                field: field as i32,
                values: reading(&robot, field),
                ..wire::StateReading::default()
            })
            .collect(),
        privileged: observation.privileged.map(privileged),
    }
}

pub(crate) fn image(frame: Frame) -> wire::Image {
    wire::Image {
        camera: frame.camera,
        width: frame.width,
        height: frame.height,
        rgb: frame.rgb.into(),
    }
}

fn reading(robot: &RobotState, field: StateField) -> Vec<f64> {
    match field {
        // Descriptions with this field are refused before a rollout begins.
        StateField::Unspecified => Vec::new(),
        StateField::EefPos => robot.eef_pos.to_vec(),
        StateField::EefQuatXyzw => robot.eef_quat_xyzw.to_vec(),
        StateField::EefAxisAngle => robot.eef_axis_angle.to_vec(),
        StateField::EefRotation => robot.eef_rotation.to_vec(),
        StateField::JointPos => robot.joint_pos.to_vec(),
        StateField::JointVel => robot.joint_vel.to_vec(),
        StateField::GripperPos => robot.gripper_pos.to_vec(),
        StateField::GripperVel => robot.gripper_vel.to_vec(),
    }
}

fn privileged(state: Privileged) -> wire::PrivilegedState {
    let joint = |(name, position)| wire::JointReading { name, position };
    let predicate = |predicate: Predicate| wire::GoalPredicate {
        predicate: predicate.name,
        arguments: predicate.arguments,
    };
    wire::PrivilegedState {
        entities: state.entities.into_iter().map(entity).collect(),
        joints: state.joints.into_iter().map(joint).collect(),
        goal: state.goal.into_iter().map(predicate).collect(),
        grip_pos: state.grip_pos.to_vec(),
        grip_quat: state.grip_quat_wxyz.to_vec(),
        gripper_opening: state.gripper_opening,
    }
}

fn entity(entity: Entity) -> wire::Entity {
    use wire::entity::Kind;
    let kind = match entity.kind {
        EntityKind::Object => Kind::Object,
        EntityKind::Fixture => Kind::Fixture,
        EntityKind::Site => Kind::Site,
    };
    wire::Entity {
        name: entity.name,
        kind: kind as i32,
        category: entity.category,
        pos: entity.pos.to_vec(),
        quat: entity.quat_wxyz.to_vec(),
        half_extents: entity.half_extents.to_vec(),
        centre: entity.centre.to_vec(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_gets_readings_in_the_requested_order() {
        let robot = RobotState {
            eef_pos: [1.0, 2.0, 3.0],
            eef_quat_xyzw: [0.0, 0.0, 0.0, 1.0],
            eef_axis_angle: [0.0; 3],
            eef_rotation: [0.0; 9],
            joint_pos: [0.0; 7],
            joint_vel: [0.0; 7],
            gripper_pos: [0.04, -0.04],
            gripper_vel: [0.0; 2],
        };
        let observation = Observation { frames: Vec::new(), robot, privileged: None };
        let wanted = [StateField::GripperPos, StateField::EefPos];
        let converted = to_wire(observation, &wanted);
        let values: Vec<&[f64]> =
            converted.state.iter().map(|reading| reading.values.as_slice()).collect();
        assert_eq!(values, [&[0.04, -0.04][..], &[1.0, 2.0, 3.0]]);
        assert_eq!(converted.state[0].field, StateField::GripperPos as i32);
    }
}
