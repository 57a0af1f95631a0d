//! Random streams of a perturbation: the blur's angle, the bias direction, the
//! misalignment axis, the noise of each step.
//!
//! In the `matched` realisation the key of a stream consists of task, level, configuration and
//! axis, without the condition and the replicate: an axis alone and the same axis
//! in a combination realise the same perturbation, step for step, and replicates
//! differ only in the policy's seed. The simulator defines which values are drawn from the
//! streams.

use std::f64::consts::PI;

use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use sha2::{Digest, Sha256};

use crate::axis::Axis;
use crate::condition::Realisation;
use crate::level::Level;
use crate::numpy::{standard_normal, unit_from_bits};
use crate::rollout_id::RolloutId;
use crate::seeds::reference_seed;
use crate::suite::TaskRef;

/// Part of the key of every matched stream. It must change whenever the draws or their order
/// change, so that old and new results are never mixed.
const STREAM_VERSION: &str = "libero-ctrl/v0.1/matched/1";

/// The source of one axis's random elements in one rollout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Randomness {
    Matched(MatchedStream),
    /// NumPy's generators: `default_rng(seed)` for elements that are fixed for the rollout,
    /// `default_rng(seed + 1)` for the noise of each step.
    Reference {
        seed: u64,
    },
}

impl Randomness {
    pub fn of(id: &RolloutId, axis: Axis, realisation: Realisation) -> Self {
        match realisation {
            Realisation::Matched => {
                Self::Matched(MatchedStream::new(id.task(), id.level(), id.number(), axis))
            }
            Realisation::Reference => Self::Reference { seed: reference_seed(id, axis) },
        }
    }
}

/// A ChaCha key, which gives an independent generator for every step and lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MatchedStream {
    key: [u8; 32],
}

impl MatchedStream {
    pub fn new(task: TaskRef, level: Level, config: u16, axis: Axis) -> Self {
        Self::named(&format!("{STREAM_VERSION}/{task}/{level}/c{config}/{axis}"))
    }

    pub(crate) fn named(name: &str) -> Self {
        Self { key: Sha256::digest(name.as_bytes()).into() }
    }

    /// Generator of the draws made once per rollout.
    pub fn fixed(&self) -> MatchedRng {
        self.rng(0)
    }

    /// Returns the generator of the draws at control step `step` on `lane`, for
    /// example a camera. The draws do not depend on draws at other steps and lanes.
    pub fn at(&self, step: u32, lane: u32) -> MatchedRng {
        self.rng(1 + (u64::from(lane) << 32 | u64::from(step)))
    }

    fn rng(&self, stream: u64) -> MatchedRng {
        let mut rng = ChaCha12Rng::from_seed(self.key);
        rng.set_stream(stream);
        MatchedRng(rng)
    }
}

/// A sequence of draws of a [`MatchedStream`].
#[derive(Clone, Debug)]
pub struct MatchedRng(ChaCha12Rng);

impl MatchedRng {
    /// Draws uniformly from [0, 1).
    pub fn random(&mut self) -> f64 {
        unit_from_bits(self.0.next_u64())
    }

    /// Draws the angle of an undirected line, uniformly from [0, π).
    pub fn line_angle(&mut self) -> f64 {
        PI * self.random()
    }

    pub fn standard_normal(&mut self) -> f64 {
        standard_normal(|| self.0.next_u64())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matched(id: &str, axis: Axis) -> MatchedStream {
        let id = id.parse().expect("an id");
        match Randomness::of(&id, axis, Realisation::Matched) {
            Randomness::Matched(stream) => stream,
            Randomness::Reference { .. } => unreachable!("the realisation is matched"),
        }
    }

    #[test]
    fn an_axis_alone_and_simultaneous_share_a_stream() {
        let alone = matched("long/t5/sensor/L3/c08", Axis::Sensor);
        let combined = matched("long/t5/simultaneous/L3/c08", Axis::Sensor);
        assert_eq!(alone, combined);
        for different in [
            matched("long/t5/simultaneous/L3/c08", Axis::Actuation),
            matched("long/t5/sensor/L2/c08", Axis::Sensor),
            matched("long/t5/sensor/L3/c07", Axis::Sensor),
            matched("long/t4/sensor/L3/c08", Axis::Sensor),
            matched("goal/t5/sensor/L3/c08", Axis::Sensor),
        ] {
            assert_ne!(alone, different);
        }
    }

    #[test]
    fn draws_of_a_step_and_lane_do_not_depend_on_earlier_draws() {
        let stream = matched("goal/t0/sensor/L1/c00", Axis::Sensor);
        let first = stream.at(3, 1).standard_normal();
        stream.at(0, 0).standard_normal();
        assert_eq!(stream.at(3, 1).standard_normal(), first);
        assert_ne!(stream.at(3, 0).standard_normal(), first);
        assert_ne!(stream.at(4, 1).standard_normal(), first);
        assert_ne!(stream.fixed().standard_normal(), first);
    }

    /// Pins the stream: a change here changes the perturbation of every
    /// campaign and needs a new [`STREAM_VERSION`].
    #[test]
    fn the_stream_of_a_configuration_never_changes() {
        let stream = matched("spatial/t0/sensor/L1/c00", Axis::Sensor);
        assert_eq!(stream.fixed().line_angle(), 1.4957436172051148);
        assert_eq!(stream.at(0, 0).standard_normal(), 1.0948609584483822);
    }
}
