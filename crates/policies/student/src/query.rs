//! Queries to the network, and its answers.

use crate::error::QueryError;

/// Pixels along a side of a picture.
pub const PICTURE_SIDE: usize = 256;
/// Bytes of a picture: red, green and blue of each pixel.
pub const PICTURE_BYTES: usize = PICTURE_SIDE * PICTURE_SIDE * 3;
/// Actions of a chunk.
pub const ACTIONS: usize = 8;
/// Numbers of an action that move the arm.
pub(crate) const ARM: usize = 6;
/// Numbers of the robot's state.
pub(crate) const STATE: usize = 14;

/// Answer to a query, action after action: three numbers that shift the hand, three that
/// turn it, all from -1 to 1, and the gripper: 1 closes it, -1 opens it.
pub type Chunk = [[f32; ARM + 1]; ACTIONS];

/// Observation at one moment, to be answered by a [`Chunk`].
#[derive(Debug, Clone, Copy)]
pub struct Query<'a> {
    /// Picture of the scene's camera: [`PICTURE_BYTES`] bytes, RGB, row after row, row 0
    /// at the bottom of the picture.
    pub agentview: &'a [u8],
    /// Picture of the hand's camera, in the same layout.
    pub wrist: &'a [u8],
    /// Position of the hand, metres, world frame.
    pub eef_pos: [f64; 3],
    /// Orientation of the hand body, row-major rotation matrix.
    pub eef_rotation: [f64; 9],
    /// Positions of the two finger joints, metres.
    pub gripper_pos: [f64; 2],
    /// The task, in words.
    pub instruction: &'a str,
}

impl Query<'_> {
    /// Checks that the query can be answered. `query` is its index among others, for the
    /// error.
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
            // As the network sees them: a finite f64 may be infinite as f32.
            let wrong = values.iter().position(|value| !(*value as f32).is_finite());
            if let Some(place) = wrong {
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

    /// The robot's state in the network's order, each number rounded to f32.
    pub(crate) fn state(&self) -> [f32; STATE] {
        let mut state = [0.0; STATE];
        let readings = self.eef_pos.iter().chain(&self.eef_rotation);
        for (slot, value) in state.iter_mut().zip(readings.chain(&self.gripper_pos)) {
            *slot = *value as f32;
        }
        state
    }
}

/// Output of the network before it becomes actions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Output {
    /// Six numbers of the arm per action, not yet limited to -1..1.
    pub arm: [[f32; ARM]; ACTIONS],
    /// Score per action for a closed gripper; above 0 it closes.
    pub gripper_logits: [f32; ACTIONS],
}

impl Output {
    /// The actions that these numbers stand for.
    pub fn chunk(&self) -> Chunk {
        std::array::from_fn(|k| {
            let mut action = [0.0; ARM + 1];
            for (slot, value) in action.iter_mut().zip(self.arm[k]) {
                *slot = value.clamp(-1.0, 1.0);
            }
            action[ARM] = if self.gripper_logits[k] > 0.0 {
                1.0
            } else {
                -1.0
            };
            action
        })
    }

    pub(crate) fn is_finite(&self) -> bool {
        let mut numbers = self.arm.as_flattened().iter().chain(&self.gripper_logits);
        numbers.all(|number| number.is_finite())
    }
}
