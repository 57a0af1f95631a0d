//! Realised perturbations and their comparison.

use std::collections::BTreeMap;

use crate::Axis;
use serde::{Deserialize, Serialize};

/// Tolerance for equal realised values, in their own unit (metres, radians, fractions of full
/// brightness). Values come from trigonometry and inverse kinematics, whose last bits differ
/// between processors; different perturbations differ by far more.
///
/// Values within 1e-9 of each other must count as equal, and values 1e-6 apart as different. The
/// tolerance lies ten times above 1e-9 and a hundred times below 1e-6, so that rounding at either
/// bound does not matter.
pub const TOLERANCE: f64 = 1e-8;

/// The perturbed axes of a rollout with their realised values. Empty for a nominal rollout. Never
/// contains language, which has no values.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Realised(BTreeMap<Axis, RealisedAxis>);

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RealisedAxis {
    /// Parameters of the manifest row.
    pub parameters: Vec<f64>,
    /// Realised elements: poses, light arrays, joints, drawn elements.
    pub elements: Vec<f64>,
}

impl Realised {
    pub fn add(&mut self, axis: Axis, parameters: Vec<f64>, elements: Vec<f64>) {
        self.0.insert(axis, RealisedAxis { parameters, elements });
    }

    /// Returns the perturbed axes with their realisations, in the order of [`Axis`].
    pub fn axes(&self) -> impl Iterator<Item = (Axis, &RealisedAxis)> {
        self.0.iter().map(|(axis, realised)| (*axis, realised))
    }

    /// Returns the realisation of one axis, if it is perturbed.
    pub fn of(&self, axis: Axis) -> Option<&RealisedAxis> {
        self.0.get(&axis)
    }
}

impl RealisedAxis {
    /// Describes the first difference from another realisation of the same axis; `None` if they
    /// agree. The text ends with the other realisation's value, so that the caller can append the
    /// place of that value.
    pub fn difference(&self, other: &RealisedAxis) -> Option<String> {
        differing("parameter", &self.parameters, &other.parameters)
            .or_else(|| differing("realised value", &self.elements, &other.elements))
    }
}

fn differing(name: &str, values: &[f64], other_values: &[f64]) -> Option<String> {
    if values.len() != other_values.len() {
        let (count, other_count) = (values.len(), other_values.len());
        return Some(format!("the number of {name}s is {count} here and {other_count}"));
    }
    // NaN differs from every value.
    let agree = |(a, b): (&f64, &f64)| (a - b).abs() <= TOLERANCE || a == b;
    let place = values.iter().zip(other_values).position(|pair| !agree(pair))?;
    let (value, other_value) = (values[place], other_values[place]);
    Some(format!("{name} {place} is {value} here and {other_value}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(elements: &[f64]) -> RealisedAxis {
        RealisedAxis { parameters: vec![0.25], elements: elements.to_vec() }
    }

    #[test]
    fn values_1e_9_apart_agree_and_values_1e_6_apart_differ_at_any_magnitude() {
        // Includes values half-way between multiples of 1e-9, at which rounded values would differ.
        for at in [0.0, 0.5e-9, 0.3, 1.0 - 0.5e-9, -2.5, 4.999_999_999_5, 1e3] {
            for direction in [1.0, -1.0] {
                let near = values(&[7.0, at + direction * 1e-9]);
                assert_eq!(values(&[7.0, at]).difference(&near), None, "{at}");
                let far = values(&[7.0, at + direction * 1e-6]);
                let difference = values(&[7.0, at]).difference(&far);
                assert!(difference.is_some_and(|words| words.contains("value 1")), "{at}");
            }
        }
    }

    #[test]
    fn lists_of_different_length_and_nan_differ() {
        let difference = values(&[1.0]).difference(&values(&[1.0, 2.0]));
        assert_eq!(difference.as_deref(), Some("the number of realised values is 1 here and 2"));
        let nan = values(&[f64::NAN]);
        assert!(nan.difference(&nan).is_some());
    }
}
