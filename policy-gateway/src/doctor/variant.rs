//! Modifies an observation as a pipeline with one common mistake would. Pure functions.

use std::fmt;

use proto::policy::{DescribeResponse, Image, Observation, StateField};

use crate::doctor::layout::{self, Part, Parts};
use crate::doctor::pose;
use crate::doctor::synthetic::Situation;

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Variant {
    /// Rotates or flips the frames of one camera, or of all cameras if `None`.
    Turned(Turn, Option<String>),
    /// Swaps the first two cameras' frames.
    CamerasSwapped,
    /// Reverses the channels to blue, green, red.
    ColoursReversed,
    /// Changes the sign of quaternions and axis-angles.
    Sign(SignRule),
    /// Replaces the concatenated readings by these parts.
    State(Vec<Part>),
}

/// Rotation or flip of a frame in upright view, in which row 0 is at the bottom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Turn {
    /// Flip, top to bottom.
    UpsideDown,
    /// Flip, left to right.
    Mirrored,
    Half,
    /// Rotation by 90° to the left.
    Left,
    /// Rotation by 90° to the right.
    Right,
}

/// Rule that selects one of the two quaternions of an orientation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SignRule {
    Negated,
    /// The quaternion with w ≥ 0.
    PositiveW,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Topic {
    Orientation,
    Cameras,
    Colours,
    Sign,
    State,
}

impl Variant {
    /// Returns all variants that can affect a server with this description. `other` is the
    /// description of the server with which the server is compared.
    pub(crate) fn all(described: &DescribeResponse, other: &DescribeResponse) -> Vec<Self> {
        let mut variants = vec![];
        let cameras = &described.cameras;
        let single_cameras = || cameras.iter().map(|camera| Some(camera.name.clone()));
        let groups: Vec<Option<String>> = match cameras.len() {
            0 => vec![],
            1 => vec![None],
            _ => [None].into_iter().chain(single_cameras()).collect(),
        };
        let is_square = cameras.iter().all(|camera| camera.width == camera.height);
        for turn in Turn::ALL {
            if is_square || !matches!(turn, Turn::Left | Turn::Right) {
                variants.extend(groups.iter().map(|group| Self::Turned(turn, group.clone())));
            }
        }
        if let [first, second, ..] = &cameras[..]
            && (first.width, first.height) == (second.width, second.height)
        {
            variants.push(Self::CamerasSwapped);
        }
        if !cameras.is_empty() {
            variants.push(Self::ColoursReversed);
        }
        let orientations = [StateField::EefQuatXyzw, StateField::EefAxisAngle];
        if described.state().any(|field| orientations.contains(&field)) {
            variants.push(Self::Sign(SignRule::Negated));
            variants.push(Self::Sign(SignRule::PositiveW));
        }
        let fields: Vec<StateField> = described.state().collect();
        let other_fields: Vec<StateField> = other.state().collect();
        let layouts = layout::confusable(&fields, &other_fields);
        variants.extend(layouts.into_iter().map(Self::State));
        variants
    }

    pub(crate) fn topic(&self) -> Topic {
        match self {
            Self::Turned(..) => Topic::Orientation,
            Self::CamerasSwapped => Topic::Cameras,
            Self::ColoursReversed => Topic::Colours,
            Self::Sign(_) => Topic::Sign,
            Self::State(_) => Topic::State,
        }
    }

    /// Returns true if applying the variant twice changes nothing, so that it explains the same
    /// difference whether it is applied to A's or to B's observations.
    pub(crate) fn is_its_own_inverse(&self) -> bool {
        match self {
            Self::Turned(turn, _) => !matches!(turn, Turn::Left | Turn::Right),
            Self::Sign(SignRule::PositiveW) | Self::State(_) => false,
            Self::CamerasSwapped | Self::ColoursReversed | Self::Sign(SignRule::Negated) => true,
        }
    }

    pub(crate) fn apply(&self, situation: &Situation, observation: &mut Observation) {
        match self {
            Self::Turned(turn, only) => {
                for image in &mut observation.images {
                    if only.as_ref().is_none_or(|camera| *camera == image.camera) {
                        turn.apply(image);
                    }
                }
            }
            Self::CamerasSwapped => {
                if let [first, second, ..] = &mut observation.images[..] {
                    std::mem::swap(&mut first.rgb, &mut second.rgb);
                }
            }
            Self::ColoursReversed => {
                for image in &mut observation.images {
                    let pixels = image.rgb.chunks_exact(3);
                    let reversed = pixels.flat_map(|rgb| [rgb[2], rgb[1], rgb[0]]);
                    image.rgb = reversed.collect::<Vec<u8>>().into();
                }
            }
            Self::Sign(rule) => {
                for reading in &mut observation.state {
                    rule.apply(reading.field(), &mut reading.values);
                }
            }
            Self::State(parts) => {
                let mut numbers = layout::numbers(parts, situation).into_iter();
                for value in observation.state.iter_mut().flat_map(|reading| &mut reading.values) {
                    *value = numbers.next().unwrap_or_default();
                }
            }
        }
    }
}

impl Turn {
    const ALL: [Self; 5] = [Self::UpsideDown, Self::Half, Self::Mirrored, Self::Left, Self::Right];

    fn apply(self, image: &mut Image) {
        let (width, height) = (image.width as usize, image.height as usize);
        if image.rgb.len() != 3 * width * height {
            return;
        }
        let from = |row: usize, column: usize| match self {
            Self::UpsideDown => (height - 1 - row, column),
            Self::Mirrored => (row, width - 1 - column),
            Self::Half => (height - 1 - row, width - 1 - column),
            // For square frames only. Rows count from the bottom.
            Self::Left => (width - 1 - column, row),
            Self::Right => (column, height - 1 - row),
        };
        let mut turned = Vec::with_capacity(image.rgb.len());
        for row in 0..height {
            for column in 0..width {
                let (row, column) = from(row, column);
                let start = 3 * (row * width + column);
                turned.extend_from_slice(&image.rgb[start..start + 3]);
            }
        }
        image.rgb = turned.into();
    }
}

impl SignRule {
    fn apply(self, field: StateField, values: &mut [f64]) {
        let quaternion = match (field, &*values) {
            (StateField::EefQuatXyzw, &[x, y, z, w]) => [x, y, z, w],
            (StateField::EefAxisAngle, &[x, y, z]) => pose::from_axis_angle([x, y, z]),
            _ => return,
        };
        if self == Self::PositiveW && quaternion[3] >= 0.0 {
            return;
        }
        let negated = quaternion.map(|number| -number);
        match field {
            StateField::EefQuatXyzw => values.copy_from_slice(&negated),
            _ => values.copy_from_slice(&pose::axis_angle(negated)),
        }
    }
}

impl fmt::Display for Variant {
    /// Describes the changed observation: "frames turned by 180°".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Turned(turn, only) => {
                match only {
                    None => write!(f, "frames ")?,
                    Some(camera) => write!(f, "frames of {camera} ")?,
                }
                f.write_str(match turn {
                    Turn::UpsideDown => "flipped vertically",
                    Turn::Mirrored => "mirrored left to right",
                    Turn::Half => "turned by 180°",
                    Turn::Left => "turned by 90° to the left",
                    Turn::Right => "turned by 90° to the right",
                })
            }
            Self::CamerasSwapped => f.write_str("the frames of the two cameras exchanged"),
            Self::ColoursReversed => f.write_str("frames in blue, green, red (BGR)"),
            Self::Sign(SignRule::Negated) => f.write_str("the quaternion's sign flipped"),
            Self::Sign(SignRule::PositiveW) => {
                f.write_str("the quaternion's sign chosen so that w is not negative")
            }
            Self::State(parts) => write!(f, "a state of {}", Parts(parts)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(rgb: &[u8]) -> Image {
        Image {
            camera: "agentview".to_owned(),
            width: 2,
            height: 2,
            rgb: rgb.iter().flat_map(|value| [*value; 3]).collect::<Vec<u8>>().into(),
        }
    }

    #[test]
    fn frames_are_turned_in_the_upright_picture() {
        // Bottom row 1 2, top row 3 4.
        for (turn, expected) in [
            (Turn::UpsideDown, [3, 4, 1, 2]),
            (Turn::Mirrored, [2, 1, 4, 3]),
            (Turn::Half, [4, 3, 2, 1]),
            // The upper right corner becomes the upper left corner.
            (Turn::Left, [3, 1, 4, 2]),
            (Turn::Right, [2, 4, 1, 3]),
        ] {
            let mut turned = image(&[1, 2, 3, 4]);
            turn.apply(&mut turned);
            assert_eq!(turned, image(&expected), "{turn:?}");
        }
    }
}
