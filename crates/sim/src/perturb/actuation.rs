//! The actuation axis: distorts actions between the policy and the controller. The gripper
//! component is not distorted, only clipped to [−1, 1].

use benchmark::ActuationDistortion;
use benchmark::numpy::DefaultRng;
use benchmark::streams::{MatchedStream, Randomness};
use nalgebra::{Rotation3, Unit, Vector3};

/// Lags up to this are not applied, control steps.
const NEGLIGIBLE_LAG: f64 = 1e-9;
/// Noise up to this is not applied, action units.
const NEGLIGIBLE_NOISE: f64 = 1e-12;
/// Number of action components for the arm: translation and rotation.
const ARM: usize = 6;

#[derive(Clone)]
pub struct ActuationStage {
    gain: f64,
    misalignment: Rotation3<f64>,
    bias: [f64; ARM],
    /// Weight of the new action in the lagged action; 1 without lag.
    responsiveness: f64,
    noise_sigma: [f64; ARM],
    noise: StepNoise,
    lagged: [f64; ARM],
    step: u32,
    fixed: FixedElements,
}

#[derive(Clone, Copy)]
struct FixedElements {
    bias_direction: [f64; ARM],
    misalignment_axis: [f64; 3],
}

#[derive(Clone)]
enum StepNoise {
    Matched(MatchedStream),
    Reference(DefaultRng),
}

impl ActuationStage {
    /// `demo_action_rms` ([`benchmark::Suite::demo_action_rms`]) is for translation and rotation.
    pub fn new(
        distortion: &ActuationDistortion,
        demo_action_rms: [f64; 2],
        randomness: &Randomness,
    ) -> Self {
        let fixed = FixedElements::draw(randomness);
        let [translation, rotation] = demo_action_rms;
        let scale: [f64; ARM] = std::array::from_fn(|i| if i < 3 { translation } else { rotation });
        let axis = Unit::new_unchecked(Vector3::from(fixed.misalignment_axis));
        let angle = distortion.misalign_deg.to_radians();
        let lag = distortion.lag_tau.abs();
        let bias_direction = fixed.bias_direction;
        Self {
            gain: distortion.gain_log2.exp2(),
            misalignment: Rotation3::from_axis_angle(&axis, angle),
            bias: std::array::from_fn(|i| distortion.bias_frac * bias_direction[i] * scale[i]),
            responsiveness: if lag > NEGLIGIBLE_LAG { 1.0 / (1.0 + lag) } else { 1.0 },
            noise_sigma: scale.map(|scale| distortion.noise_frac.abs() * scale),
            noise: match *randomness {
                Randomness::Matched(stream) => StepNoise::Matched(stream),
                Randomness::Reference { seed } => StepNoise::Reference(DefaultRng::seed(seed + 1)),
            },
            lagged: [0.0; ARM],
            step: 0,
            fixed,
        }
    }

    /// Gain, misalignment, bias, lag and noise in this order, then clipping to [−1, 1].
    pub fn apply(&mut self, action: &[f64; 7]) -> [f64; 7] {
        let translation = Vector3::new(action[0], action[1], action[2]) * self.gain;
        let rotation = Vector3::new(action[3], action[4], action[5]) * self.gain;
        let translation = self.misalignment * translation;
        let rotation = self.misalignment * rotation;
        let noise = self.next_noise();
        let mut output = *action;
        for i in 0..ARM {
            let aligned = if i < 3 { translation[i] } else { rotation[i - 3] };
            let share = self.responsiveness;
            self.lagged[i] = share * (aligned + self.bias[i]) + (1.0 - share) * self.lagged[i];
            output[i] = self.lagged[i] + noise[i] * self.noise_sigma[i];
        }
        output.map(|component| component.clamp(-1.0, 1.0))
    }

    /// Elements stored with the result: bias direction, misalignment axis, noise of the next step.
    pub fn realised(&self) -> Vec<f64> {
        let noise = self.clone().next_noise();
        [self.fixed.bias_direction.as_slice(), &self.fixed.misalignment_axis, &noise].concat()
    }

    /// Draws nothing if no component's noise exceeds [`NEGLIGIBLE_NOISE`].
    fn next_noise(&mut self) -> [f64; ARM] {
        let step = self.step;
        self.step += 1;
        if self.noise_sigma.iter().all(|&sigma| sigma <= NEGLIGIBLE_NOISE) {
            return [0.0; ARM];
        }
        match &mut self.noise {
            StepNoise::Matched(stream) => {
                let mut rng = stream.at(step, 0);
                std::array::from_fn(|_| rng.standard_normal())
            }
            StepNoise::Reference(rng) => std::array::from_fn(|_| rng.standard_normal()),
        }
    }
}

impl FixedElements {
    /// Draws six normals for the bias direction, then three for the axis.
    fn draw(randomness: &Randomness) -> Self {
        match *randomness {
            Randomness::Matched(stream) => {
                let mut rng = stream.fixed();
                Self::from_normals(|| rng.standard_normal())
            }
            Randomness::Reference { seed } => {
                let mut rng = DefaultRng::seed(seed);
                Self::from_normals(|| rng.standard_normal())
            }
        }
    }

    fn from_normals(mut normal: impl FnMut() -> f64) -> Self {
        Self {
            bias_direction: unit_vector(&mut normal),
            misalignment_axis: unit_vector(&mut normal),
        }
    }
}

fn unit_vector<const N: usize>(normal: &mut impl FnMut() -> f64) -> [f64; N] {
    let vector: [f64; N] = std::array::from_fn(|_| normal());
    let norm = vector.iter().map(|x| x * x).sum::<f64>().sqrt();
    vector.map(|x| x / norm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use benchmark::{Axis, Realisation, RolloutId};

    fn stage(id: &str, distortion: &ActuationDistortion) -> ActuationStage {
        let id: RolloutId = id.parse().expect("an id");
        let randomness = Randomness::of(&id, Axis::Actuation, Realisation::Matched);
        ActuationStage::new(distortion, [0.5, 0.1], &randomness)
    }

    const ACTION: [f64; 7] = [0.3, -0.2, 0.1, 0.05, 0.0, -0.05, -1.0];

    #[test]
    fn zero_distortion_changes_no_action() {
        let mut stage = stage("goal/t0/actuation/L1/c00", &ActuationDistortion::default());
        let output = stage.apply(&ACTION);
        for (value, expected) in output.into_iter().zip(ACTION) {
            assert!((value - expected).abs() < 1e-15);
        }
    }

    #[test]
    fn lagged_actions_start_from_zero() {
        let distortion = ActuationDistortion { lag_tau: -1.0, ..ActuationDistortion::default() };
        let mut stage = stage("goal/t0/actuation/L1/c00", &distortion);
        assert!((stage.apply(&ACTION)[0] - 0.15).abs() < 1e-15);
        assert!((stage.apply(&ACTION)[0] - 0.225).abs() < 1e-15);
    }

    #[test]
    fn the_gripper_component_is_unchanged() {
        let distortion = ActuationDistortion::from([1.0, 2.0, 30.0, 1.0, 2.0]);
        let mut stage = stage("goal/t0/actuation/L3/c00", &distortion);
        for _ in 0..20 {
            let output = stage.apply(&ACTION);
            assert_eq!(output[6], -1.0);
            assert!(output.iter().all(|x| x.abs() <= 1.0));
        }
    }

    #[test]
    fn single_axis_and_simultaneous_distort_actions_equally_at_every_step() {
        let distortion = ActuationDistortion::from([0.1, 0.2, 3.0, 1.0, 0.3]);
        let mut single_axis = stage("goal/t0/actuation/L3/c07", &distortion);
        let mut combined = stage("goal/t0/simultaneous/L3/c07", &distortion);
        assert_eq!(single_axis.realised(), combined.realised());
        for _ in 0..50 {
            assert_eq!(single_axis.apply(&ACTION), combined.apply(&ACTION));
        }
    }

    /// The expected numbers were drawn by NumPy, seeded with the CRC-32 of the rollout's id.
    #[test]
    fn the_reference_realisation_draws_numpys_directions() {
        let id: RolloutId = "spatial/t0/actuation/L1/c00".parse().expect("an id");
        let randomness = Randomness::of(&id, Axis::Actuation, Realisation::Reference);
        let distortion = ActuationDistortion::default();
        let stage = ActuationStage::new(&distortion, [0.785, 0.102], &randomness);
        let expected = [
            -0.32204775732050916,
            -0.5365161538078588,
            -0.21724780448103678,
            0.39653341733909636,
            0.4394889371379086,
            0.45918381202193,
            -0.798800428837207,
            0.3308669060024068,
            -0.5024390165999141,
        ];
        for (value, expected) in stage.realised().into_iter().zip(expected) {
            assert!((value - expected).abs() < 1e-15, "{value} is not {expected}");
        }
    }
}
