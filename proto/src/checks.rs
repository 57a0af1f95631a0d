//! Validation of a policy server's responses: its description, and its chunks of
//! actions. Worker and gateway apply the same validation, so that a response is judged the
//! same whether a campaign's endpoint is a gateway or the policy server itself.
//!
//! Numbers beyond ±1 and up to [`LARGEST_NUMBER`] are accepted: the worker clips them
//! and counts the clipped actions in the result.

use crate::PROTOCOL_VERSION;
use crate::policy::{CameraRequest, DescribeResponse, InferResponse, StateField};
use thiserror::Error;

/// Numbers in one action: translation (3), rotation (3), gripper.
pub const ACTION_WIDTH: usize = 7;
/// Largest horizon that a policy may declare: twice LIBERO's longest episode.
pub const MAX_HORIZON: u32 = 1040;
/// Largest side of a frame that a policy may request, pixels.
pub const MAX_FRAME_SIDE: u32 = 1024;
/// Largest number of frames of one observation; that many frames of the largest size fit a message.
pub const MAX_CAMERAS: usize = 8;
const _: () = assert!(
    MAX_CAMERAS * 3 * (MAX_FRAME_SIDE * MAX_FRAME_SIDE) as usize <= crate::MAX_MESSAGE_BYTES
);
/// The cameras of a LIBERO scene; other simulators may have any. Films, the student, openpi's client and the
/// fidelity tests rely on these two in this order.
pub const CAMERAS: [&str; 2] = ["agentview", "robot0_eye_in_hand"];

/// Largest number of readings that a policy may request by name.
const MAX_READINGS: usize = 16;
/// Longest name of a reading or a camera, bytes.
const MAX_NAME_BYTES: usize = 64;

/// Longest quoted part of a name in a description, characters.
const QUOTED_CHARS: usize = 64;

/// Largest magnitude of a number in an action. Policies that return millimetres, degrees or pixels
/// by mistake stay below this limit; their actions are clipped and counted. Larger numbers come
/// from a broken neural network; clipping them would report its failure as a failed task.
pub const LARGEST_NUMBER: f32 = 1e3;

pub type WireAction = [f32; ACTION_WIDTH];

/// Returns the actions of a response if a robot can execute them.
pub fn actions(response: &InferResponse, horizon: u32) -> Result<&[WireAction], ActionFault> {
    if response.action_width as usize != ACTION_WIDTH {
        return Err(ActionFault::Width { width: response.action_width });
    }
    let (actions, rest) = response.actions.as_chunks::<ACTION_WIDTH>();
    if !rest.is_empty() {
        return Err(ActionFault::Ragged { numbers: response.actions.len() });
    }
    if actions.is_empty() {
        return Err(ActionFault::Empty);
    }
    if actions.len() > horizon as usize {
        return Err(ActionFault::TooMany { count: actions.len(), horizon });
    }
    let is_number = |number: &f32| number.is_finite() && number.abs() <= LARGEST_NUMBER;
    let Some(index) = response.actions.iter().position(|number| !is_number(number)) else {
        return Ok(actions);
    };
    let (action, component) = (index / ACTION_WIDTH, index % ACTION_WIDTH);
    let value = response.actions[index];
    Err(if value.is_finite() {
        ActionFault::TooLarge { action, component, value }
    } else {
        ActionFault::NotFinite { action, component, value }
    })
}

pub fn description(described: &DescribeResponse) -> Result<(), DescriptionFault> {
    let DescribeResponse { protocol_version, horizon, execute, .. } = *described;
    if protocol_version != PROTOCOL_VERSION {
        return Err(DescriptionFault::Version { given: protocol_version });
    }
    if described.name.is_empty() {
        return Err(DescriptionFault::Nameless);
    }
    for (field, text) in [
        ("name", &described.name),
        ("checkpoint", &described.checkpoint),
        ("checkpoint digest", &described.checkpoint_digest),
        ("batch mode", &described.batch_mode),
    ] {
        if text.len() > crate::MAX_TEXT_BYTES {
            let bytes = text.len();
            return Err(DescriptionFault::Text { field, bytes });
        }
    }
    if !(1..=MAX_HORIZON).contains(&horizon) {
        return Err(DescriptionFault::Horizon { horizon });
    }
    if !(1..=horizon).contains(&execute) {
        return Err(DescriptionFault::Execute { execute, horizon });
    }
    // A list of any length is checked fast: the loop ends at the first unknown or repeated reading.
    for (index, &field) in described.state.iter().enumerate() {
        if matches!(StateField::try_from(field), Err(_) | Ok(StateField::Unspecified)) {
            return Err(DescriptionFault::StateField { field });
        }
        if described.state[..index].contains(&field) {
            return Err(DescriptionFault::RepeatedStateField { field });
        }
    }
    for (index, name) in described.readings.iter().enumerate() {
        let is_new = !described.readings[..index].contains(name);
        if index >= MAX_READINGS || !(1..=MAX_NAME_BYTES).contains(&name.len()) || !is_new {
            let name = name.chars().take(QUOTED_CHARS).collect();
            return Err(DescriptionFault::Reading { name });
        }
    }
    let count = described.cameras.len();
    if count > MAX_CAMERAS {
        return Err(DescriptionFault::Cameras { count });
    }
    for (index, camera) in described.cameras.iter().enumerate() {
        check_camera(camera)?;
        if described.cameras[..index].contains(camera) {
            return Err(DescriptionFault::RepeatedCamera {
                camera: camera.name.clone(),
                width: camera.width,
                height: camera.height,
            });
        }
    }
    match described.settings_problem() {
        Some(problem) => Err(DescriptionFault::Settings { problem }),
        None => Ok(()),
    }
}

fn check_camera(camera: &CameraRequest) -> Result<(), DescriptionFault> {
    let CameraRequest { name, width, height } = camera;
    if !(1..=MAX_NAME_BYTES).contains(&name.len()) {
        return Err(DescriptionFault::Camera { name: name.chars().take(QUOTED_CHARS).collect() });
    }
    let sides = 1..=MAX_FRAME_SIDE;
    if !sides.contains(width) || !sides.contains(height) {
        return Err(DescriptionFault::FrameSide {
            camera: name.clone(),
            width: *width,
            height: *height,
        });
    }
    Ok(())
}

/// Reason why a response is not a valid chunk of actions. The message is a clause, in which "it" is
/// the policy.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ActionFault {
    #[error("its actions are {width} numbers wide, not {ACTION_WIDTH}")]
    Width { width: u32 },
    #[error("it answered no action")]
    Empty,
    #[error("it answered {numbers} numbers, which is not a multiple of {ACTION_WIDTH}")]
    Ragged { numbers: usize },
    #[error("it answered {count} actions, but its description declares at most {horizon}")]
    TooMany { count: usize, horizon: u32 },
    #[error("component {component} of action {action} is {value}")]
    NotFinite { action: usize, component: usize, value: f32 },
    #[error(
        "component {component} of action {action} is {value:e}, and actions lie within -1..1: \
         check the un-normalisation"
    )]
    TooLarge { action: usize, component: usize, value: f32 },
}

/// Reason why a description is unusable. The message is a clause, in which "it" is the policy.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DescriptionFault {
    #[error(
        "it uses policy protocol version {given}, and this program uses version \
         {PROTOCOL_VERSION}; upgrade the older side"
    )]
    Version { given: u32 },
    #[error("it has no name")]
    Nameless,
    #[error("its {field} has {bytes} bytes, and results hold at most {}", crate::MAX_TEXT_BYTES)]
    Text { field: &'static str, bytes: usize },
    #[error("its horizon is {horizon}, not within 1..={MAX_HORIZON}")]
    Horizon { horizon: u32 },
    #[error("it declares {execute} executed actions per query, but a horizon of {horizon}")]
    Execute { execute: u32, horizon: u32 },
    #[error("it requests robot reading {field}, which this protocol version does not have")]
    StateField { field: i32 },
    #[error("it requests robot reading {field} twice")]
    RepeatedStateField { field: i32 },
    #[error(
        "it requests reading {name:?} by name; at most {MAX_READINGS} different names of 1 to \
         {MAX_NAME_BYTES} bytes are read"
    )]
    Reading { name: String },
    #[error("it requests {count} frames per query, but at most {MAX_CAMERAS} are rendered")]
    Cameras { count: usize },
    #[error("it requests frames of {width}×{height} pixels from camera {camera:?} twice")]
    RepeatedCamera { camera: String, width: u32, height: u32 },
    #[error("it requests frames of camera {name:?}; a name has 1 to {MAX_NAME_BYTES} bytes")]
    Camera { name: String },
    #[error(
        "it requests frames of {width}×{height} pixels from camera {camera:?}, but sides are 1 to \
         {MAX_FRAME_SIDE}"
    )]
    FrameSide { camera: String, width: u32, height: u32 },
    #[error("it {problem}")]
    Settings {
        /// Clause about the setting and its problem; follows "it".
        problem: String,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(actions: &[f32], action_width: u32) -> InferResponse {
        InferResponse { actions: actions.to_vec(), action_width }
    }

    #[test]
    fn valid_actions_are_returned_unchanged() {
        let numbers: Vec<f32> = (0..14_u8).map(|n| f32::from(n) / 16.0).collect();
        let response = answer(&numbers, 7);
        let read = actions(&response, 2).expect("valid actions");
        assert_eq!(read.as_flattened(), numbers);
    }

    #[test]
    fn numbers_beyond_one_pass_because_the_worker_clips_and_counts_them() {
        assert!(actions(&answer(&[-LARGEST_NUMBER; 7], 7), 1).is_ok());
    }

    #[test]
    fn every_invalid_answer_is_refused_with_its_fault() {
        let mut infinite = [0.0; 14];
        infinite[9] = f32::INFINITY;
        let cases = [
            (answer(&[0.0; 18], 6), ActionFault::Width { width: 6 }),
            (answer(&[], 7), ActionFault::Empty),
            (answer(&[0.0; 8], 7), ActionFault::Ragged { numbers: 8 }),
            (answer(&[0.0; 21], 7), ActionFault::TooMany { count: 3, horizon: 2 }),
            (
                answer(&infinite, 7),
                ActionFault::NotFinite { action: 1, component: 2, value: f32::INFINITY },
            ),
            (
                answer(&[0.0, 0.0, -1e9, 0.0, 0.0, 0.0, 0.0], 7),
                ActionFault::TooLarge { action: 0, component: 2, value: -1e9 },
            ),
        ];
        for (response, fault) in cases {
            assert_eq!(actions(&response, 2), Err(fault));
        }
    }

    #[test]
    fn every_invalid_description_is_refused_with_its_fault() {
        let camera =
            |name: &str, width, height| CameraRequest { name: name.to_owned(), width, height };
        let valid = DescribeResponse {
            protocol_version: PROTOCOL_VERSION,
            name: "p".to_owned(),
            horizon: 8,
            execute: 8,
            cameras: CAMERAS.map(|name| camera(name, MAX_FRAME_SIDE, MAX_FRAME_SIDE)).to_vec(),
            ..DescribeResponse::default()
        };
        assert_eq!(description(&valid), Ok(()));

        let check = |change: &dyn Fn(&mut DescribeResponse), fault| {
            let mut described = valid.clone();
            change(&mut described);
            assert_eq!(description(&described), Err(fault));
        };
        check(
            &|description| description.protocol_version = 9,
            DescriptionFault::Version { given: 9 },
        );
        check(&|description| description.name.clear(), DescriptionFault::Nameless);
        for horizon in [0, MAX_HORIZON + 1] {
            check(
                &|description| description.horizon = horizon,
                DescriptionFault::Horizon { horizon },
            );
        }
        for execute in [0, 9] {
            let horizon = 8;
            check(
                &|description| description.execute = execute,
                DescriptionFault::Execute { execute, horizon },
            );
        }
        for field in [0, 99] {
            check(
                &|description| description.state = vec![field],
                DescriptionFault::StateField { field },
            );
        }
        check(
            &|description| description.cameras[0].name.clear(),
            DescriptionFault::Camera { name: String::new() },
        );
        for width in [0, MAX_FRAME_SIDE + 1] {
            check(
                &|description| description.cameras[1].width = width,
                DescriptionFault::FrameSide {
                    camera: CAMERAS[1].to_owned(),
                    width,
                    height: MAX_FRAME_SIDE,
                },
            );
        }
        check(
            &|description| {
                description.cameras = (1..=9).map(|side| camera(CAMERAS[0], side, side)).collect()
            },
            DescriptionFault::Cameras { count: 9 },
        );
        check(
            &|description| description.cameras[1] = description.cameras[0].clone(),
            DescriptionFault::RepeatedCamera {
                camera: CAMERAS[0].to_owned(),
                width: MAX_FRAME_SIDE,
                height: MAX_FRAME_SIDE,
            },
        );
        let field = StateField::EefPos.into();
        check(
            &|description| description.state = vec![field, StateField::GripperPos.into(), field],
            DescriptionFault::RepeatedStateField { field },
        );
        check(
            &|description| description.readings = vec!["all".to_owned(); 2],
            DescriptionFault::Reading { name: "all".to_owned() },
        );
        let (long, bytes) = (|| "x".repeat(513), 513);
        check(
            &|description| description.checkpoint = long(),
            DescriptionFault::Text { field: "checkpoint", bytes },
        );
        check(
            &|description| description.batch_mode = long(),
            DescriptionFault::Text { field: "batch mode", bytes },
        );
        check(
            &|description| description.settings = vec![crate::policy::Setting::default()],
            DescriptionFault::Settings {
                problem: "gives setting 0 a name of 0 bytes: 1 to 64 fit".to_owned(),
            },
        );
    }
}
