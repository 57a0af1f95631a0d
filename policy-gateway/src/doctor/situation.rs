//! Situation of the robot, converted to observations for servers with different inputs: frames of
//! the requested size, readings of the requested kind.

use policy_backends::openpi::frame::resize;
use proto::policy::{
    DescribeResponse, Image, Observation, PrivilegedState, StateField, StateReading,
};
use thiserror::Error;

use crate::doctor::pose::{self, Quaternion};

#[derive(Clone, Debug, Default)]
pub struct Situation {
    pub suite: String,
    pub instruction: String,
    /// Frames by camera, with row 0 at the bottom.
    pub frames: Vec<Image>,
    /// Readings, at most one of each kind.
    pub readings: Vec<(StateField, Vec<f64>)>,
    pub privileged: Option<PrivilegedState>,
}

#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum MissingInput {
    #[error("frames of {camera:?}")]
    Frames { camera: String },
    /// No reading of this field, nor of a field from which the reading can be derived.
    #[error("the robot reading {}", field.as_str_name())]
    Reading { field: StateField },
    #[error("the simulator's own state")]
    Privileged,
}

impl Situation {
    /// Returns the observation for a server with this description.
    ///
    /// # Errors
    /// If the situation lacks a requested input that cannot be derived.
    pub fn observation(&self, described: &DescribeResponse) -> Result<Observation, MissingInput> {
        let mut observation = Observation::default();
        for camera in &described.cameras {
            let frame = self.frames.iter().find(|frame| frame.camera == camera.name);
            let frame =
                frame.ok_or_else(|| MissingInput::Frames { camera: camera.name.clone() })?;
            observation.images.push(resized(frame, camera.width, camera.height));
        }
        for field in described.state() {
            let values = self.reading(field).ok_or(MissingInput::Reading { field })?;
            observation.state.push(StateReading { field: field.into(), values });
        }
        if described.privileged {
            let state = self.privileged.clone().ok_or(MissingInput::Privileged);
            observation.privileged = Some(state?);
        }
        Ok(observation)
    }

    /// Returns a reading as stored, or derived from another representation of the orientation.
    pub fn reading(&self, field: StateField) -> Option<Vec<f64>> {
        if let Some((_, values)) = self.readings.iter().find(|(stored, _)| *stored == field) {
            return Some(values.clone());
        }
        let quaternion = self.quaternion()?;
        match field {
            StateField::EefQuatXyzw => Some(quaternion.to_vec()),
            StateField::EefAxisAngle => Some(pose::axis_angle(quaternion).to_vec()),
            StateField::EefRotation => Some(pose::matrix(quaternion).to_vec()),
            _ => None,
        }
    }

    /// Returns the hand's orientation, from any stored representation.
    pub fn quaternion(&self) -> Option<Quaternion> {
        self.readings.iter().find_map(|(field, values)| match field {
            StateField::EefQuatXyzw => values.as_slice().try_into().ok(),
            StateField::EefAxisAngle => {
                let rotation = values.as_slice().try_into().ok()?;
                Some(pose::from_axis_angle(rotation))
            }
            StateField::EefRotation => {
                let matrix = values.as_slice().try_into().ok()?;
                Some(pose::from_matrix(matrix))
            }
            _ => None,
        })
    }
}

/// Resizes a frame with Pillow's bilinear filter.
pub fn resized(frame: &Image, width: u32, height: u32) -> Image {
    let size = |width: u32, height: u32| [width as usize, height as usize];
    let from = size(frame.width, frame.height);
    if frame.rgb.len() != 3 * from[0] * from[1] || (frame.width, frame.height) == (width, height) {
        return frame.clone();
    }
    Image {
        camera: frame.camera.clone(),
        width,
        height,
        rgb: resize(&frame.rgb, from, size(width, height)).into(),
    }
}

#[cfg(test)]
mod tests {
    use proto::policy::CameraRequest;

    use super::*;

    #[test]
    fn an_observation_holds_the_inputs_that_a_description_requests() {
        let situation = Situation {
            frames: vec![Image {
                camera: "agentview".to_owned(),
                width: 4,
                height: 4,
                rgb: vec![9; 48].into(),
            }],
            readings: vec![(StateField::EefAxisAngle, vec![0.0, 0.0, 1.0])],
            ..Situation::default()
        };
        let mut described = DescribeResponse {
            cameras: vec![CameraRequest { name: "agentview".to_owned(), width: 3, height: 2 }],
            state: vec![StateField::EefQuatXyzw.into()],
            ..DescribeResponse::default()
        };
        let observation = situation.observation(&described).expect("all inputs");
        assert_eq!(observation.images[0].rgb, vec![9; 18]);
        assert!((observation.state[0].values[3] - 0.5_f64.cos()).abs() < 1e-9);

        described.state = vec![StateField::JointPos.into()];
        let missing = situation.observation(&described).expect_err("no joints");
        assert!(missing.to_string().contains("JOINT_POS"), "{missing}");
    }
}
