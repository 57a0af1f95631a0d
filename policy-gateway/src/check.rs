//! What a policy may say: the checks at the boundary, before an answer goes on
//! towards a robot. Pure. Numbers a little outside -1..1 pass here: the worker
//! clips them and counts what it clipped, because only it writes results.

use proto::policy::{DescribeResponse, InferResponse, StateField};
use thiserror::Error;

/// Queries in one `InferBatch`.
pub const MAX_BATCH_QUERIES: usize = 64;

/// Numbers in one action: translation (3), rotation (3), gripper.
pub const ACTION_WIDTH: u32 = 7;
/// Longest chunk that a policy may declare: twice LIBERO's longest episode.
pub const MAX_HORIZON: u32 = 1040;

/// Largest number taken for an action. Policies that answer millimetres, degrees
/// or pixels by mistake stay below it, and are clipped and counted; what is
/// beyond comes from no robot's units but from a broken network, and clipping it
/// would count the failure as the task's.
pub const LARGEST_NUMBER: f32 = 1e3;

/// Checks one answer against the horizon that the policy declared, and returns
/// the number of actions in it.
///
/// # Errors
/// When the answer is not n × 7 finite numbers with 0 < n ≤ `horizon`, none of
/// them beyond [`LARGEST_NUMBER`].
pub fn actions(response: &InferResponse, horizon: u32) -> Result<u32, ActionFault> {
    if response.action_width != ACTION_WIDTH {
        return Err(ActionFault::Width {
            width: response.action_width,
        });
    }
    let numbers = response.actions.len();
    if numbers == 0 {
        return Err(ActionFault::Empty);
    }
    let width = ACTION_WIDTH as usize;
    if !numbers.is_multiple_of(width) {
        return Err(ActionFault::Ragged { numbers });
    }
    let count = numbers / width;
    if count > horizon as usize {
        return Err(ActionFault::TooMany { count, horizon });
    }
    let is_number = |number: &f32| number.is_finite() && number.abs() <= LARGEST_NUMBER;
    let Some(at) = response.actions.iter().position(|it| !is_number(it)) else {
        return Ok(count as u32);
    };
    let (action, component, value) = (at / width, at % width, response.actions[at]);
    Err(match value.is_finite() {
        false => ActionFault::NotFinite {
            action,
            component,
            value,
        },
        true => ActionFault::TooLarge {
            action,
            component,
            value,
        },
    })
}

/// Checks what a policy says about itself. The protocol version is the
/// handshake's business.
///
/// # Errors
/// When it has no name, a horizon or chunk that no rollout can execute, a
/// robot reading that does not exist, or frames that no message holds.
pub fn description(described: &DescribeResponse) -> Result<(), DescriptionFault> {
    let DescribeResponse {
        horizon, execute, ..
    } = *described;
    if described.name.is_empty() {
        return Err(DescriptionFault::Nameless);
    }
    if !(1..=MAX_HORIZON).contains(&horizon) {
        return Err(DescriptionFault::Horizon { horizon });
    }
    if !(1..=horizon).contains(&execute) {
        return Err(DescriptionFault::Execute { execute, horizon });
    }
    for &field in &described.state {
        if matches!(
            StateField::try_from(field),
            Err(_) | Ok(StateField::Unspecified)
        ) {
            return Err(DescriptionFault::StateField { field });
        }
    }
    let mut bytes = 0_u64;
    for camera in &described.cameras {
        if camera.width == 0 || camera.height == 0 {
            return Err(DescriptionFault::EmptyFrame {
                camera: camera.name.clone(),
            });
        }
        let frame = u64::from(camera.width) * u64::from(camera.height);
        bytes = bytes.saturating_add(frame.saturating_mul(3));
    }
    if bytes > proto::MAX_MESSAGE_BYTES as u64 {
        return Err(DescriptionFault::FramesTooLarge { bytes });
    }
    if let Some(problem) = described.settings_problem() {
        return Err(DescriptionFault::Settings { problem });
    }
    Ok(())
}

/// How many queries of this policy go to its server at once, by what it
/// declares and what a message holds.
pub fn batch_size(described: &DescribeResponse) -> usize {
    let cameras = described.cameras.iter();
    let pixels = cameras.map(|it| u64::from(it.width) * u64::from(it.height));
    // Readings are small; half of the message leaves them more than enough.
    let query_bytes = 3 * pixels.sum::<u64>().max(1);
    let fitting = proto::MAX_MESSAGE_BYTES as u64 / 2 / query_bytes;
    let declared = u64::from(described.max_batch).min(MAX_BATCH_QUERIES as u64);
    declared.min(fitting).max(1) as usize
}

/// The first thing in which two descriptions differ, in words. How large a batch
/// a replica takes is its own affair.
pub fn difference(one: &DescribeResponse, other: &DescribeResponse) -> Option<String> {
    let said = |it: &DescribeResponse| {
        [
            ("name", it.name.clone()),
            ("checkpoint digest", it.checkpoint_digest.clone()),
            ("checkpoint", it.checkpoint.clone()),
            ("parameter count", it.parameters.to_string()),
            ("horizon", it.horizon.to_string()),
            ("execute", it.execute.to_string()),
            ("cameras", format!("{:?}", it.cameras)),
            ("robot readings", format!("{:?}", it.state)),
            ("stateful", it.stateful.to_string()),
            ("stochastic", it.stochastic.to_string()),
            ("seeding", (!it.unseeded).to_string()),
            ("language", it.language.to_string()),
            ("privileged", it.privileged.to_string()),
        ]
    };
    let setting = |of: &DescribeResponse, name: &str| {
        let named = of.settings.iter().find(|setting| setting.name == name);
        named.map_or_else(|| "not given".to_owned(), |setting| setting.value.clone())
    };
    let names = one.settings.iter().chain(&other.settings);
    let names = names.map(|setting| setting.name.as_str());
    said(one)
        .into_iter()
        .zip(said(other))
        .map(|((what, was), (_, is))| (what, was, is))
        .chain(names.map(|name| (name, setting(one, name), setting(other, name))))
        .find(|(_, was, is)| was != is)
        .map(|(what, was, is)| format!("its {what} is {is:?}, not {was:?}"))
}

/// Why an answer is not a chunk of actions.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ActionFault {
    /// Not seven numbers to an action.
    #[error("its actions are {width} numbers wide, not {ACTION_WIDTH}")]
    Width {
        /// As answered.
        width: u32,
    },
    /// No action at all.
    #[error("it answered no action")]
    Empty,
    /// Numbers left over.
    #[error("it answered {numbers} numbers, which are no whole actions of {ACTION_WIDTH}")]
    Ragged {
        /// As answered.
        numbers: usize,
    },
    /// More actions than declared.
    #[error("it answered {count} actions, but its Describe says at most {horizon}")]
    TooMany {
        /// Actions answered.
        count: usize,
        /// As declared.
        horizon: u32,
    },
    /// NaN or infinite.
    #[error("component {component} of action {action} is {value}")]
    NotFinite {
        /// Which action of the chunk, from 0.
        action: usize,
        /// Which of its seven numbers, from 0.
        component: usize,
        /// As answered.
        value: f32,
    },
    /// Beyond [`LARGEST_NUMBER`].
    #[error(
        "component {component} of action {action} is {value:e}, and actions lie within -1..1: is \
         it un-normalised?"
    )]
    TooLarge {
        /// Which action of the chunk, from 0.
        action: usize,
        /// Which of its seven numbers, from 0.
        component: usize,
        /// As answered.
        value: f32,
    },
}

/// Why a description cannot be true.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DescriptionFault {
    /// Results could not say what they belong to.
    #[error("it has no name")]
    Nameless,
    /// No chunk, or one longer than any episode.
    #[error("its horizon is {horizon}, not within 1..={MAX_HORIZON}")]
    Horizon {
        /// As declared.
        horizon: u32,
    },
    /// Executes nothing, or more than it answers.
    #[error("it wants {execute} actions executed per query, of a horizon of {horizon}")]
    Execute {
        /// As declared.
        execute: u32,
        /// As declared.
        horizon: u32,
    },
    /// Not in the protocol's list.
    #[error("it wants robot reading {field}, which this protocol version does not have")]
    StateField {
        /// The number on the wire.
        field: i32,
    },
    /// A frame without pixels.
    #[error("it wants frames of no pixels from camera {camera:?}")]
    EmptyFrame {
        /// Its name.
        camera: String,
    },
    /// An observation would not fit a message.
    #[error(
        "it wants {bytes} bytes of frames per query, and a message holds {}",
        proto::MAX_MESSAGE_BYTES
    )]
    FramesTooLarge {
        /// Of all frames together.
        bytes: u64,
    },
    /// Settings that no result can carry.
    #[error("it {problem}")]
    Settings {
        /// Which, and why.
        problem: String,
    },
}

#[cfg(test)]
mod tests {
    use proto::policy::CameraRequest;

    use super::*;

    fn answer(actions: &[f32], action_width: u32) -> InferResponse {
        InferResponse {
            actions: actions.to_vec(),
            action_width,
        }
    }

    #[test]
    fn whole_finite_actions_within_the_horizon_pass_and_are_counted() {
        assert_eq!(actions(&answer(&[0.0; 14], 7), 2), Ok(2));
    }

    #[test]
    fn numbers_beyond_one_pass_because_the_worker_clips_and_counts_them() {
        assert_eq!(actions(&answer(&[-LARGEST_NUMBER; 7], 7), 1), Ok(1));
    }

    #[test]
    fn every_nonsense_is_named() {
        let mut nan = [0.0; 14];
        nan[9] = f32::INFINITY;
        let cases = [
            (answer(&[0.0; 18], 6), ActionFault::Width { width: 6 }),
            (answer(&[], 7), ActionFault::Empty),
            (answer(&[0.0; 8], 7), ActionFault::Ragged { numbers: 8 }),
            (
                answer(&[0.0; 21], 7),
                ActionFault::TooMany {
                    count: 3,
                    horizon: 2,
                },
            ),
            (
                answer(&nan, 7),
                ActionFault::NotFinite {
                    action: 1,
                    component: 2,
                    value: f32::INFINITY,
                },
            ),
            (
                answer(&[0.0, 0.0, -1e9, 0.0, 0.0, 0.0, 0.0], 7),
                ActionFault::TooLarge {
                    action: 0,
                    component: 2,
                    value: -1e9,
                },
            ),
        ];
        for (response, fault) in cases {
            assert_eq!(actions(&response, 2), Err(fault));
        }
    }

    #[test]
    fn a_description_that_cannot_be_true_is_named() {
        let good = DescribeResponse {
            name: "p".to_owned(),
            horizon: 8,
            execute: 8,
            ..DescribeResponse::default()
        };
        assert_eq!(description(&good), Ok(()));

        let camera = |width| CameraRequest {
            name: "agentview".to_owned(),
            width,
            height: 1 << 20,
        };
        let cases = [
            (
                DescribeResponse {
                    name: String::new(),
                    ..good.clone()
                },
                DescriptionFault::Nameless,
            ),
            (
                DescribeResponse {
                    horizon: 0,
                    ..good.clone()
                },
                DescriptionFault::Horizon { horizon: 0 },
            ),
            (
                DescribeResponse {
                    execute: 9,
                    ..good.clone()
                },
                DescriptionFault::Execute {
                    execute: 9,
                    horizon: 8,
                },
            ),
            (
                DescribeResponse {
                    state: vec![99],
                    ..good.clone()
                },
                DescriptionFault::StateField { field: 99 },
            ),
            (
                DescribeResponse {
                    cameras: vec![camera(0)],
                    ..good.clone()
                },
                DescriptionFault::EmptyFrame {
                    camera: "agentview".to_owned(),
                },
            ),
            (
                DescribeResponse {
                    cameras: vec![camera(16)],
                    ..good.clone()
                },
                DescriptionFault::FramesTooLarge { bytes: 48 << 20 },
            ),
        ];
        for (described, fault) in cases {
            assert_eq!(description(&described), Err(fault));
        }
    }
}
