use sha2::{Digest, Sha256};

use crate::student::encoder::{self, Encoder, Scratch};
use crate::student::error::{QueryError, WeightsError};
use crate::student::linear::Linear;
use crate::student::query::{ACTIONS, ARM, Chunk, Output, Query, STATE};
use crate::student::text;
use crate::student::weights::Tensors;

const TEXT: usize = 128;
const STATE_WIDTH: usize = 64;
/// Width of the head's input: both cameras, the robot's state and the instruction.
const WIDTH: usize = 2 * encoder::WIDTH + STATE_WIDTH + TEXT;
/// Width of the head's hidden layers in format `rollout-student/1`, whose encoders locate points on
/// a grid of 16 x 16 (see `points`).
const HEAD: usize = 384;
/// Width of the head's hidden layers in format `rollout-student/2`, whose grid is 32 x 32.
const WIDE_HEAD: usize = 512;

/// A student with its weights. It is stateless and may be queried from several threads at
/// once.
#[derive(Debug)]
pub struct Network {
    name: String,
    look: Option<String>,
    digest: String,
    parameters: usize,
    words: Vec<f32>,
    text1: Linear,
    text2: Linear,
    agentview: Encoder,
    wrist: Encoder,
    state_mean: Vec<f32>,
    state_std: Vec<f32>,
    state1: Linear,
    head1: Linear,
    head2: Linear,
    arm: Linear,
    gripper: Linear,
}

impl Network {
    /// Loads a weights file: safetensors of the format `rollout-student/2`, or of
    /// `rollout-student/1`, in which points are located on a grid of 16 x 16 and the head is
    /// narrower.
    pub fn from_safetensors(bytes: &[u8]) -> Result<Self, WeightsError> {
        let mut tensors = Tensors::open(bytes)?;
        let file = &mut tensors;
        let state_std = file.single("state_std", &[STATE])?;
        if let Some(place) = state_std.iter().position(|spread| *spread <= 0.0) {
            return Err(WeightsError::NotPositive {
                tensor: "state_std".to_owned(),
                place,
                value: state_std[place].to_string(),
            });
        }
        let head = if file.is_fine() { WIDE_HEAD } else { HEAD };
        let network = Self {
            words: file.half("words.weight", &[text::BUCKETS, text::WIDTH])?,
            text1: Linear::read(file, "text1", text::WIDTH, TEXT)?,
            text2: Linear::read(file, "text2", TEXT, TEXT)?,
            agentview: Encoder::read(file, "agentview", TEXT)?,
            wrist: Encoder::read(file, "wrist", TEXT)?,
            state_mean: file.single("state_mean", &[STATE])?,
            state_std,
            state1: Linear::read(file, "state1", STATE, STATE_WIDTH)?,
            head1: Linear::read(file, "head1", WIDTH, head)?,
            head2: Linear::read(file, "head2", head, head)?,
            arm: Linear::read(file, "arm", head, ACTIONS * ARM)?,
            gripper: Linear::read(file, "gripper", head, ACTIONS)?,
            name: file.name().to_owned(),
            look: file.look().map(str::to_owned),
            parameters: file.parameters(),
            digest: hex::encode(Sha256::digest(bytes)),
        };
        tensors.finish()?;
        Ok(network)
    }

    /// Name of the weights, from the metadata of their file.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Look of the pictures that the weights were trained on, if their file names it.
    pub fn look(&self) -> Option<&str> {
        self.look.as_deref()
    }

    /// SHA-256 of the weights file, 64 hexadecimal digits.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    pub fn parameters(&self) -> usize {
        self.parameters
    }

    /// Returns a chunk of actions for each query. Queries do not affect each other. Runs on the
    /// calling thread and uses a few megabytes, plus a few kilobytes per query. If this fails, no
    /// query is answered.
    pub fn act(&self, queries: &[Query<'_>]) -> Result<Vec<Chunk>, QueryError> {
        let outputs = self.outputs(queries)?;
        Ok(outputs.iter().map(Output::chunk).collect())
    }

    /// Returns the raw outputs of the network, from which [`Self::act`] computes actions.
    pub fn outputs(&self, queries: &[Query<'_>]) -> Result<Vec<Output>, QueryError> {
        for (index, query) in queries.iter().enumerate() {
            query.check(index)?;
        }
        if queries.is_empty() {
            return Ok(Vec::new());
        }
        let outputs = self.head_outputs(&self.head_inputs(queries));
        match outputs.iter().position(|output| !output.is_finite()) {
            Some(query) => Err(QueryError::Answer { query }),
            None => Ok(outputs),
        }
    }

    fn head_inputs(&self, queries: &[Query<'_>]) -> Vec<f32> {
        let texts = self.texts(queries);
        let states = self.states(queries);
        let cameras = [&self.agentview, &self.wrist];
        let films = cameras.map(|camera| camera.films(&texts));
        let mut scratch = Scratch::default();
        let mut inputs = vec![0.0; queries.len() * WIDTH];
        for (index, row) in inputs.chunks_exact_mut(WIDTH).enumerate() {
            let (pictures, rest) = row.split_at_mut(2 * encoder::WIDTH);
            let (state, text) = rest.split_at_mut(STATE_WIDTH);
            let rgb = [queries[index].agentview, queries[index].wrist];
            let encoded = pictures.chunks_exact_mut(encoder::WIDTH);
            for (camera, encoded) in encoded.enumerate() {
                let films = (&films[camera], index);
                cameras[camera].encode(rgb[camera], films, &mut scratch, encoded);
            }
            state.copy_from_slice(&states[index * STATE_WIDTH..][..STATE_WIDTH]);
            text.copy_from_slice(&texts[index * TEXT..][..TEXT]);
        }
        inputs
    }

    fn texts(&self, queries: &[Query<'_>]) -> Vec<f32> {
        let embed = |query: &Query<'_>| text::embed(&self.words, query.instruction);
        let vectors: Vec<f32> = queries.iter().flat_map(embed).collect();
        let hidden = self.text1.apply_relu(&vectors);
        self.text2.apply_relu(&hidden)
    }

    fn states(&self, queries: &[Query<'_>]) -> Vec<f32> {
        let mut states: Vec<f32> = queries.iter().flat_map(Query::state).collect();
        for state in states.chunks_exact_mut(STATE) {
            let statistics = self.state_mean.iter().zip(&self.state_std);
            for (value, (mean, spread)) in state.iter_mut().zip(statistics) {
                *value = (*value - mean) / spread;
            }
        }
        self.state1.apply_relu(&states)
    }

    fn head_outputs(&self, inputs: &[f32]) -> Vec<Output> {
        let hidden = self.head1.apply_relu(inputs);
        let hidden = self.head2.apply_relu(&hidden);
        let arms = self.arm.apply(&hidden);
        let logits = self.gripper.apply(&hidden);
        let (moves, _) = arms.as_chunks::<ARM>();
        let (arms, _) = moves.as_chunks::<ACTIONS>();
        let (logits, _) = logits.as_chunks::<ACTIONS>();
        let output =
            |(arm, gripper_logits): (&_, &_)| Output { arm: *arm, gripper_logits: *gripper_logits };
        arms.iter().zip(logits).map(output).collect()
    }
}
