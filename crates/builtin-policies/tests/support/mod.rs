//! Random weights and queries from a seed, with the same bits on every machine, for tests and the
//! example `speed`.

// Each test program uses only a part of this module.
#![allow(dead_code, unreachable_pub)]

use std::collections::{BTreeMap, HashMap};

use builtin_policies::student::{PICTURE_BYTES, Query};
use safetensors::Dtype;
use safetensors::tensor::TensorView;

pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a multiple of 2⁻²³ in [-1, 1), which `f32` represents exactly.
    pub fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1 << 23) as f32 - 1.0
    }
}

#[derive(Clone)]
pub struct Tensor {
    pub dtype: Dtype,
    pub shape: Vec<usize>,
    pub bytes: Vec<u8>,
}

#[derive(Clone)]
pub struct Weights {
    pub metadata: HashMap<String, String>,
    pub tensors: BTreeMap<String, Tensor>,
}

impl Weights {
    pub fn random(seed: u64) -> Self {
        let metadata = [("format", "rollout-student/1"), ("name", "student")];
        let to_owned = |(key, value): (&str, &str)| (key.to_owned(), value.to_owned());
        let mut weights =
            Self { metadata: metadata.map(to_owned).into(), tensors: BTreeMap::new() };
        let mut random = Random(seed);
        let mut halves = |name: &str, shape: &[usize], centre: f32, spread: f32| {
            let count: usize = shape.iter().product();
            let bytes = (0..count).flat_map(|_| {
                let value = centre + spread * random.unit();
                half::f16::from_f32(value).to_le_bytes()
            });
            let tensor =
                Tensor { dtype: Dtype::F16, shape: shape.to_vec(), bytes: bytes.collect() };
            weights.tensors.insert(name.to_owned(), tensor);
        };
        halves("words.weight", &[4096, 48], 0.0, 0.5);
        for (name, inputs, outputs, gain) in [
            ("text1", 48, 128, 1.5),
            ("text2", 128, 128, 1.5),
            ("state1", 14, 64, 1.5),
            ("head1", 832, 384, 1.5),
            ("head2", 384, 384, 1.5),
            ("arm", 384, 48, 1.0),
            ("gripper", 384, 8, 4.0),
        ] {
            let spread = gain * (3.0 / inputs as f32).sqrt();
            halves(&format!("{name}.weight"), &[outputs, inputs], 0.0, spread);
            halves(&format!("{name}.bias"), &[outputs], 0.0, 0.1);
        }
        for camera in ["agentview", "wrist"] {
            let mut named = |name: &str, shape: &[usize], centre: f32, gain: f32| {
                let inputs: usize = shape[1..].iter().product();
                let spread =
                    if shape.len() > 1 { gain * (3.0 / inputs as f32).sqrt() } else { gain };
                halves(&format!("{camera}.{name}"), shape, centre, spread);
            };
            named("stem.conv.weight", &[32, 3, 3, 3], 0.0, 1.4);
            named("stem.norm.weight", &[32], 1.0, 0.3);
            named("stem.norm.bias", &[32], 0.0, 0.3);
            for (block, inputs, outputs) in [(1, 32, 48), (2, 48, 96), (3, 96, 128)] {
                let mut part = |part: &str, shape: &[usize], centre: f32, gain: f32| {
                    named(&format!("block{block}.{part}"), shape, centre, gain);
                };
                part("conv1.weight", &[outputs, inputs, 3, 3], 0.0, 1.4);
                part("conv2.weight", &[outputs, outputs, 3, 3], 0.0, 1.4);
                part("skip.weight", &[outputs, inputs, 1, 1], 0.0, 1.0);
                for norm in ["norm1", "norm2"] {
                    part(&format!("{norm}.weight"), &[outputs], 1.0, 0.3);
                    part(&format!("{norm}.bias"), &[outputs], 0.0, 0.3);
                }
                part("film.weight", &[2 * outputs, 128], 0.0, 0.4);
                part("film.bias", &[2 * outputs], 0.0, 0.2);
            }
            named("points.weight", &[64, 128, 1, 1], 0.0, 2.0);
            named("points.bias", &[64], 0.0, 0.3);
        }
        let mut singles = |name: &str, centre: f32, spread: f32| {
            let bytes = (0..14).flat_map(|_| (centre + spread * random.unit()).to_le_bytes());
            let tensor = Tensor { dtype: Dtype::F32, shape: vec![14], bytes: bytes.collect() };
            weights.tensors.insert(name.to_owned(), tensor);
        };
        singles("state_mean", 0.0, 0.5);
        singles("state_std", 1.0, 0.5);
        weights
    }

    pub fn bytes(&self) -> Vec<u8> {
        // Collects into the library's own map type.
        let metadata = self.metadata.clone().into_iter().collect();
        let tensors = self.tensors.iter().map(|(name, tensor)| {
            let view = TensorView::new(tensor.dtype, tensor.shape.clone(), &tensor.bytes);
            (name.as_str(), view.expect("the number of bytes that the shape needs"))
        });
        safetensors::serialize(tensors, Some(metadata)).expect("a file")
    }
}

pub struct OwnedQuery {
    pub agentview: Vec<u8>,
    pub wrist: Vec<u8>,
    pub state: [f64; 14],
    pub instruction: String,
}

impl OwnedQuery {
    /// Generates pictures of coloured patches with noise, a state, and one of a few instructions.
    pub fn random(seed: u64) -> Self {
        let mut random = Random(seed);
        let mut picture = || {
            let patches: Vec<u8> = (0..8 * 8 * 3).map(|_| random.next() as u8).collect();
            let byte = |index: usize| {
                let (row, column, channel) = (index / 768, index / 3 % 256, index % 3);
                let patch = patches[((row / 32) * 8 + column / 32) * 3 + channel];
                patch.wrapping_add(random.next() as u8 & 15)
            };
            (0..PICTURE_BYTES).map(byte).collect()
        };
        let (agentview, wrist) = (picture(), picture());
        let state = std::array::from_fn(|_| f64::from(random.unit()));
        let instructions = [
            "put the black bowl on the plate",
            "Open the middle drawer of the cabinet!",
            "",
            "pick up the alphabet soup and place it in the basket; pick up the soup",
        ];
        Self {
            agentview,
            wrist,
            state,
            instruction: instructions[seed as usize % instructions.len()].to_owned(),
        }
    }

    pub fn query(&self) -> Query<'_> {
        let state = &self.state;
        Query {
            agentview: &self.agentview,
            wrist: &self.wrist,
            eef_pos: std::array::from_fn(|i| state[i]),
            eef_rotation: std::array::from_fn(|i| state[3 + i]),
            gripper_pos: std::array::from_fn(|i| state[12 + i]),
            instruction: &self.instruction,
        }
    }
}
