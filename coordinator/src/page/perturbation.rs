//! Text description of a rollout's perturbation, with units. The parameters are defined in
//! `libero_ctrl::Perturbation`.

use libero_ctrl::{Axis, ManifestRow};

type Formatter = fn(f64) -> String;

/// Describes the perturbation of a rollout along an axis, one line per parameter.
pub(super) fn lines(row: &ManifestRow, axis: Axis) -> Vec<String> {
    let formatters: &[Formatter] = match axis {
        Axis::Camera => &CAMERA,
        Axis::Lighting => &LIGHTING,
        Axis::Robot => &ROBOT,
        Axis::Sensor => &SENSOR,
        Axis::Actuation => &ACTUATION,
        Axis::Language if row.id.is_placebo() => {
            return vec!["the canonical instruction, as placebo".to_owned()];
        }
        Axis::Language => {
            let variant = row.variant_id.as_deref().unwrap_or("as in the manifest");
            return vec![format!("paraphrase {variant}")];
        }
    };
    let values = row.perturbation.values(axis);
    let pairs = formatters.iter().zip(values);
    let lines = pairs.map(|(formatter, value)| formatter(value));
    // Typographic minus before numbers; hyphens within words stay.
    lines.map(|line| line.replace(" -", " −")).collect()
}

// Formatters of each axis's parameters, in the order of `Perturbation::values`. Parameters that act
// by magnitude are shown without a sign.

const CAMERA: [Formatter; 5] = [
    |degrees| format!("azimuth {degrees:+.1}°"),
    |degrees| format!("elevation {degrees:+.1}°"),
    |metres| format!("distance {:+.1} cm", 100.0 * metres),
    |metres| format!("look-at point along x {:+.1} cm", 100.0 * metres),
    |metres| format!("look-at point along y {:+.1} cm", 100.0 * metres),
];

const LIGHTING: [Formatter; 5] = [
    |ev| format!("brightness {ev:+.2} EV"),
    |log2| format!("warmth {log2:+.2} in log₂"),
    |log2| format!("green tint {log2:+.2} in log₂"),
    |log2| format!("ambient light ×{:.2}", log2.exp2()),
    |degrees| format!("height of the lights {degrees:+.1}°"),
];

const ROBOT: [Formatter; 6] = [
    |metres| format!("hand along x {:+.1} cm", 100.0 * metres),
    |metres| format!("hand along y {:+.1} cm", 100.0 * metres),
    |metres| format!("hand along z {:+.1} cm", 100.0 * metres),
    |degrees| format!("hand turned about x {degrees:+.1}°"),
    |degrees| format!("hand turned about y {degrees:+.1}°"),
    |degrees| format!("hand turned about z {degrees:+.1}°"),
];

const SENSOR: [Formatter; 4] = [
    |sigma| format!("noise, standard deviation {:.2} % of full scale", 100.0 * sigma.abs()),
    |px| format!("blur, standard deviation {:.2} px at 128 px", px.abs()),
    |log2| format!("JPEG quality {:.0}", 100.0 * (-log2.abs()).exp2()),
    |px| format!("motion blur {:.2} px at 128 px", px.abs()),
];

const ACTUATION: [Formatter; 5] = [
    |log2| format!("gain ×{:.2}", log2.exp2()),
    |fraction| format!("bias {:+.1} % of a demonstrated action", 100.0 * fraction),
    |degrees| format!("command frame turned {degrees:+.1}°"),
    |steps| format!("lag {:.2} control steps", steps.abs()),
    |fraction| format!("noise {:.1} % of a demonstrated action", 100.0 * fraction.abs()),
];

#[cfg(test)]
mod tests {
    use libero_ctrl::{CameraShift, Perturbation, SensorCorruption};

    use super::*;

    #[test]
    fn perturbations_have_units_and_only_meaningful_signs() {
        let perturbation = Perturbation {
            camera: Some(CameraShift::from([-3.4, 1.25, 0.021, 0.0, -0.005])),
            sensor: Some(SensorCorruption::from([-0.02, 0.7, -1.0, 2.5])),
            ..Perturbation::default()
        };
        let id = "object/t0/combination/L2/c00".parse().expect("an id");
        let row = ManifestRow::new(id, 0, 0, perturbation);
        assert_eq!(
            lines(&row, Axis::Camera),
            [
                "azimuth −3.4°",
                "elevation +1.2°",
                "distance +2.1 cm",
                "look-at point along x +0.0 cm",
                "look-at point along y −0.5 cm",
            ]
        );
        assert_eq!(
            lines(&row, Axis::Sensor),
            [
                "noise, standard deviation 2.00 % of full scale",
                "blur, standard deviation 0.70 px at 128 px",
                "JPEG quality 50",
                "motion blur 2.50 px at 128 px",
            ]
        );
        assert!(lines(&row, Axis::Robot).is_empty());
    }
}
