//! A policy with a pipeline like that of real policies, in which tests plant mistakes. Its actions
//! are a smooth function of pixels, weighted by position, of state, instruction and noise.
//! The gateway's tests include this file, too.

use std::collections::HashMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use proto::policy::policy_server::Policy;
use proto::policy::{
    CameraRequest, DescribeRequest, DescribeResponse, Image, InferBatchRequest, InferBatchResponse,
    InferRequest, InferResponse, Language, ResetRequest, ResetResponse, StateField,
};
use tonic::{Request, Response, Status};

pub(crate) type Action = [f64; 7];

/// Side of the policy's frames, pixels.
pub(crate) const SIDE: usize = 128;
/// Samples along a side of a frame, similar to a network's patches.
const PATCHES: usize = 32;
/// Number of actions computed beyond the horizon, for mistakes that skip the first actions.
const EXTRA_ACTIONS: usize = 4;

pub(crate) struct NetworkInput {
    pub(crate) frames: Vec<Image>,
    pub(crate) state: Vec<f64>,
    pub(crate) instruction: String,
    pub(crate) seed: u64,
    /// Number of earlier queries, over all sessions.
    pub(crate) earlier_queries: u64,
}

type Finish = dyn Fn(&mut Vec<Action>) + Send + Sync;

/// The policy, with its preprocessing and postprocessing.
pub(crate) struct Planted {
    pub(crate) described: DescribeResponse,
    noise: f64,
    prepare: Box<dyn Fn(&mut NetworkInput) + Send + Sync>,
    finish: Box<Finish>,
    sessions: Mutex<HashMap<String, ResetRequest>>,
    queries: AtomicU64,
}

impl Planted {
    /// Creates a policy without mistakes: two cameras, eight state values, chunks of eight actions.
    pub(crate) fn sound() -> Self {
        let camera = |name: &str| CameraRequest {
            name: name.to_owned(),
            width: SIDE as u32,
            height: SIDE as u32,
        };
        let state = [StateField::EefPos, StateField::EefAxisAngle, StateField::GripperPos];
        Self {
            described: DescribeResponse {
                protocol_version: proto::PROTOCOL_VERSION,
                name: "planted".to_owned(),
                cameras: ["agentview", "robot0_eye_in_hand"].map(camera).into(),
                state: state.map(i32::from).into(),
                horizon: 8,
                execute: 8,
                language: Language::FreeForm.into(),
                ..DescribeResponse::default()
            },
            noise: 0.0,
            prepare: Box::new(|_| {}),
            finish: Box::new(|_| {}),
            sessions: Mutex::default(),
            queries: AtomicU64::new(0),
        }
    }

    pub(crate) fn drawing(noise: f64) -> Self {
        let mut policy = Self::sound();
        policy.described.stochastic = true;
        Self { noise, ..policy }
    }

    pub(crate) fn with_state(mut self, fields: &[StateField]) -> Self {
        self.described.state = fields.iter().map(|&field| field.into()).collect();
        self
    }

    pub(crate) fn preparing(
        self,
        prepare: impl Fn(&mut NetworkInput) + Send + Sync + 'static,
    ) -> Self {
        let prepare = Box::new(prepare);
        Self { prepare, ..self }
    }

    /// Changes the output of the network, which has [`EXTRA_ACTIONS`] actions more than the answer.
    pub(crate) fn finishing(
        self,
        finish: impl Fn(&mut Vec<Action>) + Send + Sync + 'static,
    ) -> Self {
        let finish = Box::new(finish);
        Self { finish, ..self }
    }

    fn answer(&self, request: InferRequest) -> Result<InferResponse, Status> {
        let sessions = self.sessions.lock().expect("no test panics here");
        let reset = sessions.get(&request.session).cloned();
        drop(sessions);
        let reset = reset.ok_or_else(|| Status::unavailable("the session is not open"))?;
        let observation = request.observation.unwrap_or_default();
        let readings = observation.state.into_iter();
        let mut input = NetworkInput {
            state: readings.flat_map(|reading| reading.values).collect(),
            frames: observation.images,
            instruction: reset.instruction,
            seed: reset.seed,
            earlier_queries: self.queries.fetch_add(1, Ordering::SeqCst),
        };
        (self.prepare)(&mut input);
        let query = u64::from(request.query_index);
        let horizon = self.described.horizon as usize;
        let mut actions = network(&input, query, horizon + EXTRA_ACTIONS, self.noise);
        (self.finish)(&mut actions);
        let actions = actions.into_iter().take(horizon).flatten();
        Ok(InferResponse {
            actions: actions.map(|number| number as f32).collect(),
            action_width: 7,
        })
    }
}

/// Hashes words to a number between -1 and 1.
pub(crate) fn hash(words: &[u64]) -> f64 {
    let mut sum = 0x9e37_79b9_7f4a_7c15_u64;
    for word in words {
        sum = (sum ^ word).wrapping_mul(0xff51_afd7_ed55_8ccd);
        sum = (sum ^ (sum >> 33)).wrapping_mul(0xc4ce_b9fe_1a85_ec53);
        sum ^= sum >> 29;
    }
    (sum >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

/// Computes chunks that change smoothly with every input.
fn network(input: &NetworkInput, query: u64, count: usize, noise: f64) -> Vec<Action> {
    let mut features = [0.0; 14];
    for (slot, frame) in input.frames.iter().enumerate() {
        let (width, height) = (frame.width as usize, frame.height as usize);
        let scale = 2.5 / (3.0 * (PATCHES * PATCHES) as f64).sqrt();
        for patch in 0..PATCHES * PATCHES {
            let (row, column) = (patch / PATCHES, patch % PATCHES);
            let middle = |index: usize, side: usize| (2 * index + 1) * side / (2 * PATCHES);
            let start = 3 * (middle(row, height) * width + middle(column, width));
            for channel in 0..3 {
                let level = f64::from(frame.rgb[start + channel]) / 127.5 - 1.0;
                let input = (slot * PATCHES * PATCHES + patch) * 3 + channel;
                for (feature, sum) in features.iter_mut().enumerate() {
                    *sum += scale * level * weight(input, feature);
                }
            }
        }
    }
    let text = input.instruction.bytes().map(u64::from).collect::<Vec<_>>();
    for (feature, sum) in features.iter_mut().enumerate() {
        let feature = feature as u64;
        for (index, number) in input.state.iter().enumerate() {
            let phase = 3.0 * hash(&[1, index as u64, feature]);
            *sum += 0.25 * (2.0 * number + phase).sin();
        }
        *sum += 0.4 * hash(&[&[2, feature], &text[..]].concat());
    }
    let number = |row: usize, component: usize| {
        let wave = (features[component] + (0.3 + 0.1 * component as f64) * row as f64).sin();
        let deviation = noise * hash(&[3, input.seed, query, row as u64, component as u64]);
        0.7 * (wave + 0.5 * features[7 + component]).tanh() + deviation
    };
    (0..count).map(|row| std::array::from_fn(|component| number(row, component))).collect()
}

/// Returns the weight of a sampled pixel value for a feature; all weights are different.
fn weight(input: usize, feature: usize) -> f64 {
    static WEIGHTS: std::sync::OnceLock<Vec<f64>> = std::sync::OnceLock::new();
    let count = 2 * PATCHES * PATCHES * 3 * 14;
    let weights = || -> Vec<f64> { (0..count as u64).map(|index| hash(&[4, index])).collect() };
    WEIGHTS.get_or_init(weights)[input * 14 + feature]
}

pub(crate) fn upside_down(frame: &mut Image) {
    let rows = frame.rgb.chunks_exact(3 * frame.width as usize).rev();
    frame.rgb = rows.flatten().copied().collect::<Vec<u8>>().into();
}

#[tonic::async_trait]
impl Policy for Planted {
    async fn describe(
        &self,
        _: Request<DescribeRequest>,
    ) -> Result<Response<DescribeResponse>, Status> {
        Ok(Response::new(self.described.clone()))
    }

    async fn reset(
        &self,
        request: Request<ResetRequest>,
    ) -> Result<Response<ResetResponse>, Status> {
        let request = request.into_inner();
        let mut sessions = self.sessions.lock().expect("no test panics here");
        sessions.insert(request.session.clone(), request);
        Ok(Response::new(ResetResponse {}))
    }

    async fn infer(
        &self,
        request: Request<InferRequest>,
    ) -> Result<Response<InferResponse>, Status> {
        self.answer(request.into_inner()).map(Response::new)
    }

    async fn infer_batch(
        &self,
        _: Request<InferBatchRequest>,
    ) -> Result<Response<InferBatchResponse>, Status> {
        Err(Status::unimplemented("the policy takes no batches"))
    }
}
