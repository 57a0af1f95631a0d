//! A perturbation as it was realised, and when two of them are the same.

use std::collections::BTreeMap;

use libero_ctrl::Axis;
use serde::{Deserialize, Serialize};

/// Two realised values are the same if they differ by no more than this, in
/// their own unit (metres, radians, shares of full brightness). Values come from
/// trigonometry and inverse kinematics, whose last bits differ from one kind of
/// processor to another; different perturbations differ by far more.
///
/// Ten times the 1e-9 that must agree, so that rounding does not decide at the
/// edge, and a hundredth of the 1e-6 that must not.
pub const TOLERANCE: f64 = 1e-8;

/// The perturbed axes of a rollout, each with what was realised of it. Empty for
/// a nominal rollout. Language has no values and is never among them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Realised(BTreeMap<Axis, RealisedAxis>);

/// Realised values of one axis, or their digest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum RealisedAxis {
    /// The values themselves.
    Values {
        /// Parameters of the manifest row.
        parameters: Vec<f64>,
        /// Realised elements: poses, light arrays, joints, drawn elements.
        elements: Vec<f64>,
    },
    /// Their SHA-256, hex: all that database schema 2 and before kept. It agrees
    /// with everything, since there is nothing to compare it with.
    Digest(String),
}

impl Realised {
    /// Adds an axis: its parameters, and what became of them.
    pub fn add(&mut self, axis: Axis, parameters: Vec<f64>, elements: Vec<f64>) {
        let values = RealisedAxis::Values {
            parameters,
            elements,
        };
        self.0.insert(axis, values);
    }

    /// The perturbed axes, in the protocol's order, with what was realised.
    pub fn axes(&self) -> impl Iterator<Item = (Axis, &RealisedAxis)> {
        self.0.iter().map(|(axis, realised)| (*axis, realised))
    }

    /// Returns the realisation of one axis, if it is perturbed.
    pub fn of(&self, axis: Axis) -> Option<&RealisedAxis> {
        self.0.get(&axis)
    }
}

impl RealisedAxis {
    /// The first difference from another realisation of the same axis, in
    /// words; none if they agree.
    pub fn difference(&self, other: &RealisedAxis) -> Option<String> {
        let (
            RealisedAxis::Values {
                parameters,
                elements,
            },
            RealisedAxis::Values {
                parameters: other_parameters,
                elements: other_elements,
            },
        ) = (self, other)
        else {
            return None;
        };
        differing("parameter", parameters, other_parameters)
            .or_else(|| differing("realised value", elements, other_elements))
    }
}

fn differing(what: &str, here: &[f64], there: &[f64]) -> Option<String> {
    if here.len() != there.len() {
        let (here, there) = (here.len(), there.len());
        return Some(format!("it has {here} {what}s here and {there}"));
    }
    // A NaN agrees with nothing.
    let agree = |(a, b): (&f64, &f64)| (a - b).abs() <= TOLERANCE || a == b;
    let place = here.iter().zip(there).position(|pair| !agree(pair))?;
    let (here, there) = (here[place], there[place]);
    Some(format!("{what} {place} is {here} here and {there}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(elements: &[f64]) -> RealisedAxis {
        RealisedAxis::Values {
            parameters: vec![0.25],
            elements: elements.to_vec(),
        }
    }

    #[test]
    fn values_a_billionth_apart_agree_wherever_they_lie_and_a_millionth_apart_differ() {
        // Among them values at which rounding to any number of digits has an edge.
        for at in [0.0, 0.5e-9, 0.3, 1.0 - 0.5e-9, -2.5, 4.999_999_999_5, 1e3] {
            for direction in [1.0, -1.0] {
                let near = values(&[7.0, at + direction * 1e-9]);
                assert_eq!(values(&[7.0, at]).difference(&near), None, "{at}");
                let far = values(&[7.0, at + direction * 1e-6]);
                let difference = values(&[7.0, at]).difference(&far);
                assert!(
                    difference.is_some_and(|words| words.contains("value 1")),
                    "{at}"
                );
            }
        }
    }

    #[test]
    fn another_number_of_values_differs_and_so_does_what_is_no_number() {
        let difference = values(&[1.0]).difference(&values(&[1.0, 2.0]));
        assert_eq!(
            difference.as_deref(),
            Some("it has 1 realised values here and 2")
        );
        let nan = values(&[f64::NAN]);
        assert!(nan.difference(&nan).is_some());
    }

    #[test]
    fn a_digest_of_an_earlier_release_reads_back_and_agrees_with_everything() {
        let stored =
            r#"{"camera":"ab","sensor":{"parameters":[0.1],"elements":[0.30000000000000004]}}"#;
        let realised: Realised = serde_json::from_str(stored).expect("JSON");
        assert_eq!(serde_json::to_string(&realised).expect("JSON"), stored);
        let digest = realised.of(Axis::Camera).expect("a digest");
        assert_eq!(digest.difference(&values(&[1.0])), None);
    }
}
