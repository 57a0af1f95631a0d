//! `builtin:student`: a small learned policy with both cameras and the instruction as inputs, for
//! evaluations without a checkpoint or a GPU. The network is in `builtin_policies::student`.

use std::convert::Infallible;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::{Arc, LazyLock};

use benchmark::attempt::{TAUGHT_ON, TAUGHT_ON_LOOK};
use builtin_policies::student::{ACTIONS, Network, PICTURE_SIDE, Query, WeightsError};
use proto::checks::CAMERAS;
use proto::policy::{CameraRequest, DescribeResponse, Language, Observation, Setting, StateField};
use thiserror::Error;
use transport::Access;

use super::backend::BuiltinBackend;
use super::{Action, BuiltinPolicy, Policy};
use crate::backend::Backend;
use crate::spec::{Kind, OwnError, Specified};

pub(crate) const KIND: Kind =
    Kind::new::<WeightsFile>(&["student"], "student:FILE (weights that training exported)");

#[derive(Clone, Debug)]
struct WeightsFile(PathBuf);

impl FromStr for WeightsFile {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(Self(text.trim_start_matches("student:").into()))
    }
}

impl fmt::Display for WeightsFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "student:{}", self.0.display())
    }
}

impl Specified for WeightsFile {
    fn open(&self, _: &Access) -> Result<Arc<dyn Backend>, OwnError> {
        Ok(Arc::new(BuiltinBackend::new(self.to_string(), read(&self.0)?)))
    }
}

/// Robot readings that the student takes, in order.
const STATE: [StateField; 3] =
    [StateField::EefPos, StateField::EefRotation, StateField::GripperPos];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weights {
    /// Trained in unperturbed scenes of LIBERO's own assets.
    Libero,
    /// Trained in unperturbed scenes of the built-in assets.
    Boxes,
}

impl Weights {
    pub fn name(self) -> &'static str {
        match self {
            Self::Libero => "student",
            Self::Boxes => "student-boxes",
        }
    }

    /// Returns the name of the asset pack used in training, as in the provenance of results.
    fn training_pack(self) -> &'static str {
        match self {
            Self::Libero => "libero",
            Self::Boxes => "primitives",
        }
    }

    pub(crate) fn network(self) -> &'static Arc<Network> {
        static LIBERO: LazyLock<Arc<Network>> =
            LazyLock::new(|| shipped(builtin_policies::student::LIBERO));
        static BOXES: LazyLock<Arc<Network>> =
            LazyLock::new(|| shipped(builtin_policies::student::BOXES));
        match self {
            Self::Libero => &LIBERO,
            Self::Boxes => &BOXES,
        }
    }
}

fn shipped(weights: &[u8]) -> Arc<Network> {
    Arc::new(Network::from_safetensors(weights).expect("tests load the shipped weights"))
}

/// Reason why a weights file cannot be used. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum WeightsFileError {
    #[error("read {path:?}: give the path of weights that training/export.py wrote")]
    Unreadable { path: PathBuf, source: std::io::Error },
    #[error("use {path:?}")]
    InvalidWeights { path: PathBuf, source: WeightsError },
}

pub(crate) fn read(path: &Path) -> Result<Policy, WeightsFileError> {
    let bytes = std::fs::read(path)
        .map_err(|source| WeightsFileError::Unreadable { path: path.to_owned(), source })?;
    let network = Network::from_safetensors(&bytes)
        .map_err(|source| WeightsFileError::InvalidWeights { path: path.to_owned(), source })?;
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    let checkpoint = format!("student:{file}");
    Ok(policy(Arc::new(network), checkpoint))
}

pub(crate) fn shipped_policy(weights: Weights, checkpoint: String) -> Policy {
    let mut policy = policy(Arc::clone(weights.network()), checkpoint);
    // The weights file of `student-boxes` holds the name `student`, which is replaced here: the
    // file's digest is published, so the file must not change.
    policy.described.name = weights.name().to_owned();
    policy.described.settings.push(setting(TAUGHT_ON, weights.training_pack()));
    policy
}

fn setting(name: &str, value: &str) -> Setting {
    Setting { name: name.to_owned(), value: value.to_owned() }
}

pub(crate) fn policy(network: Arc<Network>, checkpoint: String) -> Policy {
    Policy {
        described: describe(&network, checkpoint),
        start: Box::new(move |reset| {
            Box::new(Student {
                network: Arc::clone(&network),
                instruction: reset.instruction.clone(),
            })
        }),
    }
}

fn describe(network: &Network, checkpoint: String) -> DescribeResponse {
    let side = PICTURE_SIDE as u32;
    DescribeResponse {
        protocol_version: proto::PROTOCOL_VERSION,
        name: network.name().to_owned(),
        checkpoint,
        checkpoint_digest: network.digest().to_owned(),
        parameters: network.parameters() as u64,
        cameras: CAMERAS
            .map(|name| CameraRequest { name: name.to_owned(), width: side, height: side })
            .into(),
        state: STATE.map(Into::into).into(),
        horizon: ACTIONS as u32,
        execute: ACTIONS as u32,
        language: Language::FreeForm.into(),
        settings: network.look().map(|look| setting(TAUGHT_ON_LOOK, look)).into_iter().collect(),
        ..DescribeResponse::default()
    }
}

/// The only state is the instruction.
struct Student {
    network: Arc<Network>,
    instruction: String,
}

impl BuiltinPolicy for Student {
    fn infer(
        &mut self,
        _query_index: u32,
        observation: &Observation,
    ) -> Result<Vec<Action>, String> {
        let query = Query {
            agentview: picture(observation, 0)?,
            wrist: picture(observation, 1)?,
            eef_pos: reading(observation, 0)?,
            eef_rotation: reading(observation, 1)?,
            gripper_pos: reading(observation, 2)?,
            instruction: &self.instruction,
        };
        let chunks = self.network.act(&[query]);
        let chunks = chunks.map_err(|error| error.to_string())?;
        Ok(chunks.into_iter().flatten().collect())
    }
}

/// Returns the frame at an index of [`CAMERAS`], row 0 at the bottom.
fn picture(observation: &Observation, index: usize) -> Result<&[u8], String> {
    let camera = CAMERAS[index];
    let found = observation.images.get(index);
    let found = found.filter(|image| image.camera == camera);
    found.map(|image| &*image.rgb).ok_or_else(|| {
        format!("picture {index} of the observation is not from the requested camera `{camera}`")
    })
}

fn reading<const N: usize>(observation: &Observation, index: usize) -> Result<[f64; N], String> {
    let found = observation.state.get(index);
    let values = found.and_then(|reading| reading.values.as_slice().try_into().ok());
    values.ok_or_else(|| {
        format!(
            "reading {index} of the observation is not the requested {} with {N} numbers",
            STATE[index].as_str_name()
        )
    })
}

#[cfg(test)]
mod tests {
    use proto::policy::{Image, ResetRequest, StateReading};

    use std::collections::BTreeSet;

    use super::*;

    /// Returns a grey scene with the hand above the table, in the form that the description
    /// requests.
    fn observation(described: &DescribeResponse) -> Observation {
        let image = |camera: &CameraRequest| Image {
            camera: camera.name.clone(),
            width: camera.width,
            height: camera.height,
            rgb: vec![128; (camera.width * camera.height * 3) as usize].into(),
        };
        let values = [
            vec![-0.2, 0.0, 1.1],
            vec![1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0],
            vec![0.02, -0.02],
        ];
        let reading = |(field, values): (&i32, Vec<f64>)| StateReading {
            field: *field,
            values,
            ..StateReading::default()
        };
        Observation {
            images: described.cameras.iter().map(image).collect(),
            state: described.state.iter().zip(values).map(reading).collect(),
            privileged: None,
        }
    }

    fn session(instruction: &str) -> (DescribeResponse, Box<dyn BuiltinPolicy>) {
        let network = Arc::clone(Weights::Boxes.network());
        let policy = policy(network, "builtin:student".to_owned());
        let reset = ResetRequest { instruction: instruction.to_owned(), ..ResetRequest::default() };
        (policy.described, (policy.start)(&reset))
    }

    #[test]
    fn the_student_answers_requested_observations_and_depends_on_the_instruction() {
        let (described, mut plate) = session("put the bowl on the plate");
        let (_, mut stove) = session("turn on the stove");
        let input = observation(&described);
        let actions = plate.infer(0, &input).expect("actions");
        assert_eq!(actions.len(), described.horizon as usize);
        assert!(actions.iter().flatten().all(|v| (-1.0..=1.0).contains(v)));
        assert_eq!(actions, plate.infer(5, &input).expect("actions"));
        assert_ne!(actions, stove.infer(0, &input).expect("actions"));
        assert_eq!(described.checkpoint_digest.len(), 64);
        assert!(described.parameters < 2_000_000 && !described.privileged);
    }

    #[test]
    fn an_observation_of_another_form_is_refused_with_the_fault() {
        let (described, mut student) = session("put the bowl on the plate");
        let refused = |student: &mut Box<dyn BuiltinPolicy>, change: &dyn Fn(&mut Observation)| {
            let mut input = observation(&described);
            change(&mut input);
            student.infer(0, &input).expect_err("an invalid observation")
        };
        let swapped = refused(&mut student, &|input| input.images.swap(0, 1));
        assert!(swapped.contains("the requested camera `agentview`"), "{swapped}");
        let missing = refused(&mut student, &|input| drop(input.state.pop()));
        assert!(missing.contains("STATE_FIELD_GRIPPER_POS with 2 numbers"), "{missing}");
        let small = refused(&mut student, &|input| {
            input.images[1].rgb = vec![0; 3].into();
        });
        assert!(small.contains("picture of wrist has 3 bytes"), "{small}");
    }

    #[test]
    fn the_built_in_weights_declare_their_training_assets() {
        // The built-in assets have no texture files, so that they look the same in both looks.
        for (weights, expected) in [
            (Weights::Libero, &[(TAUGHT_ON_LOOK, "mujoco-3.3.2"), (TAUGHT_ON, "libero")][..]),
            (Weights::Boxes, &[(TAUGHT_ON, "primitives")]),
        ] {
            let described = shipped_policy(weights, "builtin".to_owned()).described;
            let settings = described.settings.iter();
            let settings: Vec<_> =
                settings.map(|setting| (&*setting.name, &*setting.value)).collect();
            assert_eq!(settings, expected);
        }
    }

    #[test]
    fn every_built_in_network_has_its_own_name_and_digest() {
        let all = [Weights::Libero, Weights::Boxes];
        for weights in all {
            let described = shipped_policy(weights, "builtin".to_owned()).described;
            assert_eq!(described.name, weights.name());
        }
        let digests: BTreeSet<&str> =
            all.iter().map(|student| student.network().digest()).collect();
        assert_eq!(digests.len(), all.len());
    }
}
