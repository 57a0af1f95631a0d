//! Parameters of the five metric axes, as in a manifest row. The simulator applies them to the
//! camera, the lights, the robot's initial pose, pictures and actions; `streams` provides their
//! random elements.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::axis::Axis;
use crate::axis_set::AxisSet;
use crate::condition::Condition;
use crate::wording::JsonError;

/// A parameter of an axis.
#[derive(Clone, Copy)]
pub struct Parameter {
    /// Key in manifests.
    pub key: &'static str,
    /// Describes a value with its unit, without a sign where only the magnitude counts.
    pub text: fn(f64) -> String,
}

/// Declares the parameters of the metric axes: for each a struct whose serialised names are the
/// reference's keys, in the reference's order, and all of them as the perturbation of a rollout.
macro_rules! perturbation {
    ($(
        $(#[$meta:meta])*
        $axis:ident $field:ident: $parameters:ident {
            $($(#[$key_meta:meta])* $key:ident: $text:expr,)+
        }
    )+) => {
        $(
            $(#[$meta])*
            #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
            #[serde(deny_unknown_fields)]
            pub struct $parameters {
                $($(#[$key_meta])* pub $key: f64,)+
            }

            impl $parameters {
                const COUNT: usize = [$(stringify!($key)),+].len();
                pub(crate) const PARAMETERS: [Parameter; Self::COUNT] =
                    [$(Parameter { key: stringify!($key), text: $text }),+];
            }

            impl From<[f64; $parameters::COUNT]> for $parameters {
                fn from([$($key),+]: [f64; $parameters::COUNT]) -> Self {
                    Self { $($key),+ }
                }
            }
        )+

        /// Perturbation of one rollout: the parameters of each perturbed axis. All are absent
        /// in a nominal rollout, in a rollout of the latency axis or of a variant, and in a rollout
        /// that perturbs only language, whose perturbation is the row's instruction.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct Perturbation {
            $(
                #[serde(default, skip_serializing_if = "Option::is_none")]
                pub $field: Option<$parameters>,
            )+
        }

        impl Perturbation {
            /// Returns the perturbed metric axes in the reference's order.
            pub fn axes(&self) -> Vec<Axis> {
                let set = [$((Axis::$axis, self.$field.is_some())),+];
                set.into_iter().filter_map(|(axis, set)| set.then_some(axis)).collect()
            }

            pub fn only(&self, axes: AxisSet) -> Self {
                Self { $($field: self.$field.filter(|_| axes.contains(Axis::$axis))),+ }
            }

            /// Empty if the axis is not perturbed.
            pub fn values(&self, axis: Axis) -> Vec<f64> {
                match axis {
                    $(Axis::$axis => self.$field.map(|of| vec![$(of.$key),+]),)+
                    _ => None,
                }
                .unwrap_or_default()
            }

            /// Sets the parameters of an axis, each from its index.
            pub(crate) fn set(&mut self, axis: Axis, value: impl Fn(usize) -> f64) {
                match axis {
                    $(Axis::$axis => {
                        self.$field = Some($parameters::from(std::array::from_fn(value)));
                    })+
                    _ => {}
                }
            }
        }
    };
}

perturbation! {
    /// Displacement of the `agentview` camera in spherical coordinates about
    /// its look-at point, and of that point.
    Camera camera: CameraShift {
        /// Azimuth about the world's vertical, degrees.
        d_azimuth_deg: |degrees| format!("azimuth {degrees:+.1}°"),
        /// Elevation above the horizontal, degrees.
        d_elevation_deg: |degrees| format!("elevation {degrees:+.1}°"),
        /// Distance to the look-at point, m.
        d_distance_m: |metres| format!("distance {:+.1} cm", 100.0 * metres),
        /// Look-at point along world x, m.
        d_lookat_x_m: |metres| format!("look-at point along x {:+.1} cm", 100.0 * metres),
        /// Look-at point along world y, m.
        d_lookat_y_m: |metres| format!("look-at point along y {:+.1} cm", 100.0 * metres),
    }
    /// Change of the scene's lights.
    Lighting lighting: LightingShift {
        /// Brightness, exposure values (powers of two).
        d_intensity_ev: |ev| format!("brightness {ev:+.2} EV"),
        /// Warmth: log₂ of the red and of the inverse blue factor.
        d_log2_warm: |log2| format!("warmth {log2:+.2} in log₂"),
        /// Tint: log₂ of the green factor.
        d_tint_g: |log2| format!("green tint {log2:+.2} in log₂"),
        /// Headlight ambient, log₂ factor.
        d_log2_ambient: |log2| format!("ambient light ×{:.2}", log2.exp2()),
        /// Elevation of every light about the look-at point, degrees.
        d_elevation_deg: |degrees| format!("height of the lights {degrees:+.1}°"),
    }
    /// Displacement of the end-effector's initial pose, world frame.
    Robot robot: RobotShift {
        /// Along world x, m.
        eef_dx_m: |metres| format!("hand along x {:+.1} cm", 100.0 * metres),
        /// Along world y, m.
        eef_dy_m: |metres| format!("hand along y {:+.1} cm", 100.0 * metres),
        /// Along world z, m.
        eef_dz_m: |metres| format!("hand along z {:+.1} cm", 100.0 * metres),
        /// Rotation vector about world x, degrees.
        eef_rx_deg: |degrees| format!("hand turned about x {degrees:+.1}°"),
        /// Rotation vector about world y, degrees.
        eef_ry_deg: |degrees| format!("hand turned about y {degrees:+.1}°"),
        /// Rotation vector about world z, degrees.
        eef_rz_deg: |degrees| format!("hand turned about z {degrees:+.1}°"),
    }
    /// Corruption of the rendered pictures. Only magnitudes count; lengths in pixels are for a
    /// picture of 128 pixels and scale with the picture.
    Sensor sensor: SensorCorruption {
        /// Standard deviation of the noise, on pixel values in [0, 1].
        noise_sigma: |sigma| {
            format!("noise, standard deviation {:.2} % of full scale", 100.0 * sigma.abs())
        },
        /// Standard deviation of the Gaussian blur, pixels at 128.
        blur_sigma: |px| format!("blur, standard deviation {:.2} px at 128 px", px.abs()),
        /// JPEG quality is 100 · 2^−|value|.
        jpeg_log2: |log2| format!("JPEG quality {:.0}", 100.0 * (-log2.abs()).exp2()),
        /// Length of the motion blur, pixels at 128.
        motion_len: |px| format!("motion blur {:.2} px at 128 px", px.abs()),
    }
    /// Distortion of the six arm components of an action.
    Actuation actuation: ActuationDistortion {
        /// log₂ of the gain.
        gain_log2: |log2| format!("gain ×{:.2}", log2.exp2()),
        /// Constant offset, fraction of the demonstrations' action size.
        bias_frac: |fraction| format!("bias {:+.1} % of a demonstrated action", 100.0 * fraction),
        /// Rotation of the command frame, degrees.
        misalign_deg: |degrees| format!("command frame turned {degrees:+.1}°"),
        /// Time constant of the first-order lag, control steps; only the magnitude counts.
        lag_tau: |steps| format!("lag {:.2} control steps", steps.abs()),
        /// Standard deviation of the noise, fraction of the demonstrations'
        /// action size; only the magnitude counts.
        noise_frac: |fraction| {
            format!("noise {:.1} % of a demonstrated action", 100.0 * fraction.abs())
        },
    }
}

impl Perturbation {
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
            _ => nested,
        }
    }

    pub fn from_manifest(
        condition: Condition,
        perturb: Map<String, Value>,
    ) -> Result<Self, PerturbError> {
        let nested = match condition {
            Condition::Subset(_) | Condition::Simultaneous => perturb,
            Condition::Single(axis) if !axis.def().parameters.is_empty() => {
                Map::from_iter([(axis.name().to_owned(), Value::Object(perturb))])
            }
            _ if perturb.is_empty() => perturb,
            _ => return Err(PerturbError::NotEmpty { condition }),
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
    Parameters {
        condition: Condition,
        /// Name of the parameter and its problem.
        problem: String,
    },
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
        let perturb = all.to_manifest(Condition::Simultaneous);
        assert_eq!(perturb["camera"]["d_azimuth_deg"], -3.396913);
        let read = Perturbation::from_manifest(Condition::Simultaneous, perturb);
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
    fn a_nominal_row_has_no_parameters() {
        let camera = preset(&[Axis::Camera]).to_manifest(Condition::Single(Axis::Camera));
        assert!(Perturbation::from_manifest(Condition::Nominal, camera).is_err());
    }
}
