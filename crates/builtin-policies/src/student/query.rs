//! Queries to the network, and its outputs.

use crate::student::error::QueryError;

/// Side of a picture, pixels.
pub const PICTURE_SIDE: usize = 256;
/// Size of a picture, bytes: red, green and blue of each pixel.
pub const PICTURE_BYTES: usize = PICTURE_SIDE * PICTURE_SIDE * 3;
pub const ACTIONS: usize = 8;
pub(crate) const ARM: usize = 6;
pub(crate) const STATE: usize = 14;

/// Chunk of actions. An action has translation (3) and rotation (3) of the hand, from -1 to 1,
/// and the gripper: 1 closes it, -1 opens it.
pub type Chunk = [[f32; ARM + 1]; ACTIONS];

/// Observation of one control step, for which the network returns a [`Chunk`].
#[derive(Debug, Clone, Copy)]
pub struct Query<'a> {
    /// Picture of the camera `agentview`, which faces the table: [`PICTURE_BYTES`] bytes, RGB,
    /// row after row, row 0 at the bottom of the picture.
    pub agentview: &'a [u8],
    /// Picture of the hand's camera, in the same layout.
    pub wrist: &'a [u8],
    /// Position of the site between the fingertips, metres, world frame.
    pub eef_pos: [f64; 3],
    /// Orientation of the hand body in the world frame, row-major rotation matrix.
    pub eef_rotation: [f64; 9],
    /// Positions of the two finger joints, metres.
    pub gripper_pos: [f64; 2],
    /// The task, in words.
    pub instruction: &'a str,
}

impl Query<'_> {
    /// `query` is the index in the batch, for the error.
    pub(crate) fn check(&self, query: usize) -> Result<(), QueryError> {
        for (camera, picture) in [("agentview", self.agentview), ("wrist", self.wrist)] {
            if picture.len() != PICTURE_BYTES {
                return Err(QueryError::Picture {
                    query,
                    camera,
                    found: picture.len(),
                    expected: PICTURE_BYTES,
                });
            }
        }
        let readings: [(_, &[f64]); 3] = [
            ("eef_pos", &self.eef_pos),
            ("eef_rotation", &self.eef_rotation),
            ("gripper_pos", &self.gripper_pos),
        ];
        for (reading, values) in readings {
            // Checked after conversion: a finite f64 may be infinite as f32.
            let not_finite = values.iter().position(|value| !(*value as f32).is_finite());
            if let Some(place) = not_finite {
                return Err(QueryError::State {
                    query,
                    reading,
                    place,
                    value: values[place].to_string(),
                });
            }
        }
        Ok(())
    }

    /// In the network's order, rounded to f32.
    pub(crate) fn state(&self) -> [f32; STATE] {
        let mut state = [0.0; STATE];
        let readings = self.eef_pos.iter().chain(&self.eef_rotation);
        for (slot, value) in state.iter_mut().zip(readings.chain(&self.gripper_pos)) {
            *slot = *value as f32;
        }
        state
    }
}

/// Raw output of the network.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Output {
    /// Arm components of each action, not clamped to -1..1.
    pub arm: [[f32; ARM]; ACTIONS],
    /// Score per action for a closed gripper; above 0 the gripper closes.
    pub gripper_logits: [f32; ACTIONS],
}

impl Output {
    pub fn chunk(&self) -> Chunk {
        std::array::from_fn(|k| {
            let mut action = [0.0; ARM + 1];
            for (slot, value) in action.iter_mut().zip(self.arm[k]) {
                *slot = value.clamp(-1.0, 1.0);
            }
            action[ARM] = if self.gripper_logits[k] > 0.0 { 1.0 } else { -1.0 };
            action
        })
    }

    pub(crate) fn is_finite(&self) -> bool {
        let mut numbers = self.arm.as_flattened().iter().chain(&self.gripper_logits);
        numbers.all(|number| number.is_finite())
    }
}
