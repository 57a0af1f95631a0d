//! Parameters of the five metric axes, as in a manifest row. The simulator applies them to the
//! camera, the lights, the robot's initial pose, pictures and actions; `streams` provides their
//! random elements.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::axis::Axis;
use crate::axis_set::AxisSet;
use crate::condition::Condition;
use crate::wording::JsonError;

/// Declares the parameters of one axis: a struct whose serialised names are the
/// reference's keys, in the reference's order.
macro_rules! parameters {
    (
        $(#[$meta:meta])*
        $name:ident [$count:literal] {
            $($(#[$field_meta:meta])* $field:ident,)+
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            $($(#[$field_meta])* pub $field: f64,)+
        }

        impl $name {
            /// Keys in manifests, in order.
            pub const KEYS: [&'static str; $count] = [$(stringify!($field)),+];

            /// Returns the values in the order of [`Self::KEYS`].
            pub fn values(&self) -> [f64; $count] {
                [$(self.$field),+]
            }
        }

        impl From<[f64; $count]> for $name {
            /// Builds the parameters from values in the order of
            /// [`Self::KEYS`].
            fn from([$($field),+]: [f64; $count]) -> Self {
                Self { $($field),+ }
            }
        }
    };
}

parameters! {
    /// Displacement of the `agentview` camera in spherical coordinates about
    /// its look-at point, and of that point.
    CameraShift [5] {
        /// Azimuth about the world's vertical, degrees.
        d_azimuth_deg,
        /// Elevation above the horizontal, degrees.
        d_elevation_deg,
        /// Distance to the look-at point, m.
        d_distance_m,
        /// Look-at point along world x, m.
        d_lookat_x_m,
        /// Look-at point along world y, m.
        d_lookat_y_m,
    }
}

parameters! {
    /// Change of the scene's lights.
    LightingShift [5] {
        /// Brightness, exposure values (powers of two).
        d_intensity_ev,
        /// Warmth: log₂ of the red and of the inverse blue factor.
        d_log2_warm,
        /// Tint: log₂ of the green factor.
        d_tint_g,
        /// Headlight ambient, log₂ factor.
        d_log2_ambient,
        /// Elevation of every light about the look-at point, degrees.
        d_elevation_deg,
    }
}

parameters! {
    /// Displacement of the end-effector's initial pose, world frame.
    RobotShift [6] {
        /// Along world x, m.
        eef_dx_m,
        /// Along world y, m.
        eef_dy_m,
        /// Along world z, m.
        eef_dz_m,
        /// Rotation vector about world x, degrees.
        eef_rx_deg,
        /// Rotation vector about world y, degrees.
        eef_ry_deg,
        /// Rotation vector about world z, degrees.
        eef_rz_deg,
    }
}

parameters! {
    /// Corruption of the rendered pictures. Only magnitudes count; lengths in pixels are for a
    /// picture of 128 pixels and scale with the picture.
    SensorCorruption [4] {
        /// Standard deviation of the noise, on pixel values in [0, 1].
        noise_sigma,
        /// Standard deviation of the Gaussian blur, pixels at 128.
        blur_sigma,
        /// JPEG quality is 100 · 2^−|value|.
        jpeg_log2,
        /// Length of the motion blur, pixels at 128.
        motion_len,
    }
}

parameters! {
    /// Distortion of the six arm components of an action.
    ActuationDistortion [5] {
        /// log₂ of the gain.
        gain_log2,
        /// Constant offset, fraction of the demonstrations' action size.
        bias_frac,
        /// Rotation of the command frame, degrees.
        misalign_deg,
        /// Time constant of the first-order lag, control steps; only the magnitude counts.
        lag_tau,
        /// Standard deviation of the noise, fraction of the demonstrations'
        /// action size; only the magnitude counts.
        noise_frac,
    }
}

/// Perturbation of one rollout: the parameters of each perturbed axis. All are absent
/// in a nominal rollout, in a rollout of the latency axis or of a variant, and in a rollout that
/// perturbs only language, whose perturbation is the row's instruction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Perturbation {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<CameraShift>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lighting: Option<LightingShift>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<RobotShift>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<SensorCorruption>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub actuation: Option<ActuationDistortion>,
}

impl Perturbation {
    /// Returns the perturbed metric axes in the reference's order.
    pub fn axes(&self) -> Vec<Axis> {
        let set = [
            self.camera.is_some(),
            self.lighting.is_some(),
            self.robot.is_some(),
            self.sensor.is_some(),
            self.actuation.is_some(),
        ];
        let axes = Axis::METRIC.into_iter().zip(set);
        axes.filter_map(|(axis, set)| set.then_some(axis)).collect()
    }

    /// Returns the perturbation restricted to some axes.
    pub fn only(&self, axes: AxisSet) -> Self {
        Self {
            camera: self.camera.filter(|_| axes.contains(Axis::Camera)),
            lighting: self.lighting.filter(|_| axes.contains(Axis::Lighting)),
            robot: self.robot.filter(|_| axes.contains(Axis::Robot)),
            sensor: self.sensor.filter(|_| axes.contains(Axis::Sensor)),
            actuation: self.actuation.filter(|_| axes.contains(Axis::Actuation)),
        }
    }

    /// Returns the values of one axis in the order of its keys; empty if the axis is not
    /// perturbed.
    pub fn values(&self, axis: Axis) -> Vec<f64> {
        match axis {
            Axis::Camera => self.camera.map(|shift| shift.values().to_vec()),
            Axis::Lighting => self.lighting.map(|shift| shift.values().to_vec()),
            Axis::Robot => self.robot.map(|shift| shift.values().to_vec()),
            Axis::Sensor => self.sensor.map(|corruption| corruption.values().to_vec()),
            Axis::Actuation => self.actuation.map(|distortion| distortion.values().to_vec()),
            Axis::Language => None,
        }
        .unwrap_or_default()
    }

    /// Returns the `perturb` object of a manifest row: nested by axis for
    /// several axes, flat for one axis alone, empty if nothing is perturbed.
    pub fn to_manifest(&self, condition: Condition) -> Map<String, Value> {
        let nested = match serde_json::to_value(self) {
            Ok(Value::Object(nested)) => nested,
            _ => unreachable!("a struct of numbers serialises to an object"),
        };
        match condition {
            Condition::Single(axis) => match nested.get(axis.name()) {
                Some(Value::Object(flat)) => flat.clone(),
                _ => Map::new(),
            },
            Condition::Clean
            | Condition::Latency
            | Condition::Subset(_)
            | Condition::Combination
            | Condition::Variant => nested,
        }
    }

    /// Parses the `perturb` object of a manifest row.
    pub fn from_manifest(
        condition: Condition,
        perturb: Map<String, Value>,
    ) -> Result<Self, PerturbError> {
        let nested = match condition {
            Condition::Clean
            | Condition::Latency
            | Condition::Variant
            | Condition::Single(Axis::Language) => match perturb.is_empty() {
                true => perturb,
                false => return Err(PerturbError::NotEmpty { condition }),
            },
            Condition::Single(axis) => {
                Map::from_iter([(axis.name().to_owned(), Value::Object(perturb))])
            }
            Condition::Subset(_) | Condition::Combination => perturb,
        };
        let perturbation: Self =
            serde_json::from_value(Value::Object(nested)).map_err(|source| {
                PerturbError::Parameters {
                    condition,
                    problem: JsonError::from(source).problem().to_owned(),
                }
            })?;
        let given: AxisSet = perturbation.axes().into_iter().collect();
        match condition {
            Condition::Subset(axes) if given != axes.without(AxisSet::of(Axis::Language)) => {
                Err(PerturbError::OtherAxes { condition, given })
            }
            _ => Ok(perturbation),
        }
    }
}

/// Error: the `perturb` object does not match its condition.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PerturbError {
    #[error("read `perturb`: condition {condition} has no parameters, leave it empty")]
    NotEmpty { condition: Condition },
    #[error(
        "read `perturb` of condition {condition}: it has parameters of {given}, give the \
         parameters of the condition's axes"
    )]
    OtherAxes { condition: Condition, given: AxisSet },
    #[error("read `perturb` of condition {condition}: {problem}")]
    Parameters { condition: Condition, problem: String },
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::level::Level;
    use crate::presets::apply_preset;

    fn preset(axes: &[Axis]) -> Perturbation {
        let mut perturbation = Perturbation::default();
        for &axis in axes {
            apply_preset(&mut perturbation, axis, Level::L2, 3);
        }
        perturbation
    }

    #[test]
    fn the_perturbations_of_every_condition_are_parsed_from_their_json() {
        for axis in Axis::METRIC {
            let condition = Condition::Single(axis);
            let alone = preset(&[axis]);
            let perturb = alone.to_manifest(condition);
            let read = Perturbation::from_manifest(condition, perturb).expect("reads back");
            assert_eq!(read, alone);
            assert_eq!(read.axes(), [axis]);
        }
        let all = preset(&Axis::METRIC);
        let perturb = all.to_manifest(Condition::Combination);
        assert_eq!(perturb["camera"]["d_azimuth_deg"], -3.396913);
        let read = Perturbation::from_manifest(Condition::Combination, perturb);
        assert_eq!(read.expect("reads back"), all);
    }

    #[test]
    fn a_parameter_of_another_axis_is_refused_by_name() {
        let camera = preset(&[Axis::Camera]).to_manifest(Condition::Single(Axis::Camera));
        let error = Perturbation::from_manifest(Condition::Single(Axis::Sensor), camera)
            .expect_err("parameters of another axis");
        assert!(error.to_string().contains("d_azimuth_deg"), "{error}");
    }

    #[test]
    fn a_clean_row_has_no_parameters() {
        let camera = preset(&[Axis::Camera]).to_manifest(Condition::Single(Axis::Camera));
        assert!(Perturbation::from_manifest(Condition::Clean, camera).is_err());
    }
}
