//! Group normalisation fused with the following operations: FiLM, the skip connection, and
//! ReLU.

use crate::student::error::WeightsError;
use crate::student::lanes;
use crate::student::linear::relu;
use crate::student::weights::Tensors;

const GROUPS: usize = 8;
const EPSILON: f32 = 1e-5;

/// Normalises each group of channels to mean 0 and variance 1, then scales and shifts each
/// channel.
#[derive(Debug)]
pub(crate) struct GroupNorm {
    weight: Vec<f32>,
    bias: Vec<f32>,
}

/// Modulation of channels by the text: factor − 1 of every channel, then the shift of every
/// channel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Film<'a>(pub(crate) &'a [f32]);

impl GroupNorm {
    /// Reads `name.weight` and `name.bias`.
    pub(crate) fn read(
        tensors: &mut Tensors<'_>,
        name: &str,
        channels: usize,
    ) -> Result<Self, WeightsError> {
        Ok(Self {
            weight: tensors.half(&format!("{name}.weight"), &[channels])?,
            bias: tensors.half(&format!("{name}.bias"), &[channels])?,
        })
    }

    /// Applies norm, then ReLU, in place. `values` are planes, one per channel.
    pub(crate) fn relu(&self, values: &mut [f32]) {
        self.each_channel(values, |_, plane, scale, shift| {
            for value in plane {
                *value = relu(*value * scale + shift);
            }
        });
    }

    /// Applies norm, then `film`, then ReLU, in place.
    pub(crate) fn film_relu(&self, values: &mut [f32], film: Film<'_>) {
        let (gamma, beta) = film.0.split_at(self.weight.len());
        self.each_channel(values, |channel, plane, scale, shift| {
            // (1 + gamma) (scale x + shift) + beta
            let factor = 1.0 + gamma[channel];
            let (scale, shift) = (factor * scale, factor * shift + beta[channel]);
            for value in plane {
                *value = relu(*value * scale + shift);
            }
        });
    }

    /// Applies norm, adds `skip`, then applies ReLU, in place. `skip` has the layout of
    /// `values`.
    pub(crate) fn add_relu(&self, values: &mut [f32], skip: &[f32]) {
        let size = values.len() / self.weight.len();
        self.each_channel(values, |channel, plane, scale, shift| {
            let skip = &skip[channel * size..][..size];
            for (value, skip) in plane.iter_mut().zip(skip) {
                *value = relu((*value * scale + shift) + skip);
            }
        });
    }

    /// Calls `each` for each channel with its number, its plane, and the factor and shift that
    /// normalise it.
    fn each_channel(&self, values: &mut [f32], mut each: impl FnMut(usize, &mut [f32], f32, f32)) {
        let channels = self.weight.len();
        let size = values.len() / channels;
        for (group_index, group) in values.chunks_exact_mut(values.len() / GROUPS).enumerate() {
            let mean = lanes::mean(group);
            let squares = lanes::sum(group, |value| (value - mean) * (value - mean));
            let variance = squares / group.len() as f32;
            let inverse = 1.0 / (variance + EPSILON).sqrt();
            for (index, plane) in group.chunks_exact_mut(size).enumerate() {
                let channel = group_index * (channels / GROUPS) + index;
                let scale = self.weight[channel] * inverse;
                let shift = self.bias[channel] - mean * scale;
                each(channel, plane, scale, shift);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sixteen channels of 4 x 4; every group's mean is 3, its variance 4.
    fn values() -> Vec<f32> {
        [1.0, 5.0].repeat(128)
    }

    fn norm() -> GroupNorm {
        GroupNorm { weight: vec![2.0; 16], bias: (0..16).map(|channel| channel as f32).collect() }
    }

    fn assert_close(found: f32, expected: f32) {
        assert!((found - expected).abs() < 1e-4, "{found}, not {expected}");
    }

    #[test]
    fn groups_are_normalised_scaled_shifted_and_clamped_at_zero() {
        let mut values = values();
        norm().relu(&mut values);
        for (place, value) in values.iter().enumerate() {
            let unit = if place % 2 == 0 { -1.0 } else { 1.0 };
            assert_close(*value, (2.0 * unit + (place / 16) as f32).max(0.0));
        }
    }

    #[test]
    fn film_comes_after_the_norm_and_before_relu() {
        let (mut values, mut film) = (values(), vec![0.5; 16]);
        film.extend([-1.0; 16]);
        norm().film_relu(&mut values, Film(&film));
        // Channel 3: 1.5 (±2 + 3) - 1
        assert_close(values[48], 0.5);
        assert_close(values[49], 6.5);
        // Channel 0: 1.5 (±2) - 1
        assert_eq!(values[0], 0.0);
        assert_close(values[1], 2.0);
    }

    #[test]
    fn the_skip_is_added_before_relu() {
        let mut values = values();
        let skip: Vec<f32> = (0..256).map(|place| place as f32).collect();
        norm().add_relu(&mut values, &skip);
        // The last two values of channel 15.
        assert_close(values[254], -2.0 + 15.0 + 254.0);
        assert_close(values[255], 2.0 + 15.0 + 255.0);
        assert_eq!(values[0], 0.0);
    }
}
