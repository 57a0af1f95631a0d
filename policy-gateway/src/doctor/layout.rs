//! Layouts of a policy's state vector: the representations of a pose in published policies, and
//! other layouts of the same width that are easily confused with them. Pure functions.

use std::fmt;

use proto::policy::StateField;

use crate::doctor::pose;
use crate::doctor::synthetic::Situation;

/// Component of a state vector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// A reading of the protocol.
    Field(StateField),
    /// Roll, pitch and yaw (3).
    RollPitchYaw,
    /// x, y and z of the quaternion, without w (3).
    QuaternionVector,
    /// Axis times angle of the inverse rotation (3).
    InverseAxisAngle,
    /// The quaternion with w first (4).
    QuaternionWxyz,
    /// The quaternion of the inverse rotation (4).
    InverseQuaternion,
    /// Axis-angle followed by 0 (4).
    PaddedAxisAngle,
    /// Rotation matrix in column-major order (9).
    RotationColumns,
    /// Both finger joints as distances from the middle, not negative (2).
    FingersUnsigned,
    /// Finger joints in reverse order (2).
    FingersSwapped,
    /// Opening of each finger, as a share of its travel, 0 to 1 (2).
    FingersShare,
    /// Distance between the fingers, m (1).
    Opening,
    /// The given number of zeros.
    Zeros(usize),
}

use Part::Field;
use StateField::{
    EefAxisAngle, EefPos, EefQuatXyzw, EefRotation, GripperPos, GripperVel, JointPos, JointVel,
};

/// State vectors of published policies.
const LAYOUTS: [&[Part]; 10] = [
    &[Field(EefPos), Field(EefAxisAngle), Field(GripperPos)],
    &[Field(EefPos), Part::RollPitchYaw, Field(GripperPos)],
    &[Field(EefPos), Field(EefQuatXyzw), Part::Opening],
    &[Field(JointPos), Part::Opening],
    &[Field(EefPos), Field(EefQuatXyzw), Field(GripperPos)],
    &[Field(JointPos), Field(GripperPos)],
    &[Field(EefPos), Field(EefQuatXyzw)],
    &[Field(JointPos)],
    &[Field(EefPos), Field(EefAxisAngle), Part::Opening],
    &[Field(EefPos), Field(EefAxisAngle)],
];
/// Travel of a finger joint, m.
const FINGER_TRAVEL: f64 = 0.04;

/// Returns the layouts of the same width as `fields` with which `fields` may have been confused.
/// `other_fields`, the layout of the other server, comes first if it has this width.
pub(crate) fn confusable(fields: &[StateField], other_fields: &[StateField]) -> Vec<Vec<Part>> {
    let parts: Vec<Part> = fields.iter().map(|&field| Field(field)).collect();
    let width = width(&parts);
    if width == 0 {
        return vec![];
    }
    let mut layouts = vec![other_fields.iter().map(|&field| Field(field)).collect()];
    for (index, part) in parts.iter().enumerate() {
        for &alternative in alternatives(*part) {
            let mut layout = parts.clone();
            layout[index] = alternative;
            layouts.push(layout);
        }
    }
    layouts.extend(LAYOUTS.map(<[Part]>::to_vec));
    layouts.push(vec![Part::Zeros(width)]);
    let mut different: Vec<Vec<Part>> = vec![];
    for layout in layouts {
        if self::width(&layout) == width && layout != parts && !different.contains(&layout) {
            different.push(layout);
        }
    }
    different
}

/// Returns the parts of the same width that are easily confused with a part.
fn alternatives(part: Part) -> &'static [Part] {
    match part {
        Field(EefAxisAngle) => {
            &[Part::RollPitchYaw, Part::QuaternionVector, Part::InverseAxisAngle]
        }
        Field(EefQuatXyzw) => {
            &[Part::QuaternionWxyz, Part::InverseQuaternion, Part::PaddedAxisAngle]
        }
        Field(EefRotation) => &[Part::RotationColumns],
        Field(GripperPos) => &[Part::FingersUnsigned, Part::FingersSwapped, Part::FingersShare],
        Field(JointPos) => &[Field(JointVel)],
        _ => &[],
    }
}

fn width(parts: &[Part]) -> usize {
    parts.iter().map(|part| part.width()).sum()
}

pub(crate) fn numbers(parts: &[Part], situation: &Situation) -> Vec<f64> {
    parts.iter().flat_map(|part| part.numbers(situation)).collect()
}

impl Part {
    fn width(self) -> usize {
        match self {
            Field(EefRotation) | Self::RotationColumns => 9,
            Field(JointPos | JointVel) => 7,
            Field(EefQuatXyzw)
            | Self::QuaternionWxyz
            | Self::InverseQuaternion
            | Self::PaddedAxisAngle => 4,
            Field(EefPos | EefAxisAngle)
            | Self::RollPitchYaw
            | Self::QuaternionVector
            | Self::InverseAxisAngle => 3,
            Field(GripperPos | GripperVel)
            | Self::FingersUnsigned
            | Self::FingersSwapped
            | Self::FingersShare => 2,
            Self::Opening => 1,
            Self::Zeros(count) => count,
            Field(StateField::Unspecified) => 0,
        }
    }

    fn numbers(self, situation: &Situation) -> Vec<f64> {
        let quaternion = situation.quaternion();
        let [x, y, z, w] = quaternion;
        let inverse = [-x, -y, -z, w];
        let mut fingers = situation.reading(GripperPos);
        match self {
            Field(field) => situation.reading(field),
            Self::RollPitchYaw => pose::roll_pitch_yaw(quaternion).to_vec(),
            Self::QuaternionVector => vec![x, y, z],
            Self::InverseAxisAngle => pose::axis_angle(inverse).to_vec(),
            Self::QuaternionWxyz => vec![w, x, y, z],
            Self::InverseQuaternion => inverse.to_vec(),
            Self::PaddedAxisAngle => [&pose::axis_angle(quaternion)[..], &[0.0]].concat(),
            Self::RotationColumns => {
                let m = pose::matrix(quaternion);
                [0, 3, 6, 1, 4, 7, 2, 5, 8].map(|index| m[index]).to_vec()
            }
            Self::FingersUnsigned => fingers.iter().map(|number| number.abs()).collect(),
            Self::FingersSwapped => {
                fingers.reverse();
                fingers
            }
            Self::FingersShare => {
                fingers.iter().map(|number| number.abs() / FINGER_TRAVEL).collect()
            }
            Self::Opening => vec![fingers.iter().map(|number| number.abs()).sum()],
            Self::Zeros(count) => vec![0.0; count],
        }
    }
}

/// Formats parts as a list: "position, axis-angle and two finger joints".
pub(crate) struct Parts<'a>(pub &'a [Part]);

impl fmt::Display for Parts<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, part) in self.0.iter().enumerate() {
            f.write_str(match index {
                0 => "",
                _ if index + 1 == self.0.len() => " and ",
                _ => ", ",
            })?;
            part.fmt(f)?;
        }
        Ok(())
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Field(EefPos) => "position",
            Field(EefQuatXyzw) => "quaternion (x y z w)",
            Field(EefAxisAngle) => "axis-angle",
            Field(EefRotation) => "rotation matrix",
            Field(JointPos) => "seven joint angles",
            Field(JointVel) => "seven joint velocities",
            Field(GripperPos) => "two finger joints",
            Field(GripperVel) => "two finger velocities",
            Field(StateField::Unspecified) => "nothing",
            Self::RollPitchYaw => "roll-pitch-yaw",
            Self::QuaternionVector => "x y z of the quaternion",
            Self::InverseAxisAngle => "axis-angle of the inverse",
            Self::QuaternionWxyz => "quaternion with w first (w x y z)",
            Self::InverseQuaternion => "quaternion of the inverse",
            Self::PaddedAxisAngle => "axis-angle and a 0",
            Self::RotationColumns => "rotation matrix by columns",
            Self::FingersUnsigned => "two finger joints without their signs",
            Self::FingersSwapped => "two finger joints exchanged",
            Self::FingersShare => "two finger openings of 0 to 1",
            Self::Opening => "distance between the fingers",
            Self::Zeros(count) => return write!(f, "{count} zeros"),
        })
    }
}

#[cfg(test)]
mod tests {
    use benchmark::Suite;

    use super::*;
    use crate::doctor::synthetic::situations;

    #[test]
    fn confusable_layouts_have_the_same_width_and_other_numbers() {
        let declared = [
            vec![EefPos, EefAxisAngle, GripperPos],
            vec![EefPos, EefQuatXyzw],
            vec![EefRotation],
            vec![JointPos, GripperPos],
        ];
        let situation = &situations(Suite::Goal)[0];
        for fields in declared {
            let parts: Vec<Part> = fields.iter().map(|&field| Field(field)).collect();
            let declared = numbers(&parts, situation);
            let layouts = confusable(&fields, &[]);
            assert!(layouts.len() > 1, "{fields:?}");
            for layout in layouts {
                let numbers = numbers(&layout, situation);
                assert_eq!(numbers.len(), declared.len(), "{}", Parts(&layout));
                let pairs = numbers.iter().zip(&declared);
                let difference = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(difference > 0.005, "{}", Parts(&layout));
            }
        }
        assert!(confusable(&[], &[EefPos]).is_empty());
    }

    #[test]
    fn parts_are_displayed_as_a_list_with_and() {
        let parts = [Field(EefPos), Part::RollPitchYaw, Part::Opening];
        let expected = "position, roll-pitch-yaw and distance between the fingers";
        assert_eq!(Parts(&parts).to_string(), expected);
    }
}
