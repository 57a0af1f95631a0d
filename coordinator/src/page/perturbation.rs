//! A rollout's perturbation in words, with units. What the values do is the
//! simulator's business; what they mean is told in `protocol::Perturbation`.

use protocol::{Axis, ManifestRow};

/// How one parameter is told.
struct Told {
    name: &'static str,
    unit: &'static str,
    /// From the parameter to the unit.
    convert: fn(f64) -> f64,
    decimals: usize,
    is_signed: bool,
}

/// What an axis does in a rollout: a line for each of its parameters.
pub(super) fn lines(row: &ManifestRow, axis: Axis) -> Vec<String> {
    if axis == Axis::Language {
        let variant = row.variant_id.as_deref().unwrap_or("as in the manifest");
        return vec![format!("paraphrase {variant}")];
    }
    let values = row.perturbation.values(axis);
    let told = told(axis).iter().zip(values);
    told.map(|(told, value)| told.line(value)).collect()
}

/// The parameters of an axis, in the order of its keys.
fn told(axis: Axis) -> &'static [Told] {
    match axis {
        Axis::Camera => &CAMERA,
        Axis::Lighting => &LIGHTING,
        Axis::Robot => &ROBOT,
        Axis::Sensor => &SENSOR,
        Axis::Actuation => &ACTUATION,
        Axis::Language => &[],
    }
}

const CAMERA: [Told; 5] = [
    degrees("azimuth"),
    degrees("elevation"),
    centimetres("distance"),
    centimetres("look-at point along x"),
    centimetres("look-at point along y"),
];

const LIGHTING: [Told; 5] = [
    signed("brightness", " EV", |ev| ev, 2),
    signed("warmth", " in log₂", |log2| log2, 2),
    signed("green tint", " in log₂", |log2| log2, 2),
    magnitude("ambient light ×", "", f64::exp2, 2),
    degrees("height of the lights"),
];

const ROBOT: [Told; 6] = [
    centimetres("hand along x"),
    centimetres("hand along y"),
    centimetres("hand along z"),
    degrees("hand turned about x"),
    degrees("hand turned about y"),
    degrees("hand turned about z"),
];

const SENSOR: [Told; 4] = [
    magnitude(
        "noise, standard deviation",
        " % of full scale",
        |sigma| 100.0 * sigma.abs(),
        2,
    ),
    magnitude("blur, standard deviation", " px at 128 px", f64::abs, 2),
    magnitude("JPEG quality", "", |log2| 100.0 * (-log2.abs()).exp2(), 0),
    magnitude("motion blur", " px at 128 px", f64::abs, 2),
];

const ACTUATION: [Told; 5] = [
    magnitude("gain ×", "", f64::exp2, 2),
    signed(
        "bias",
        " % of a demonstrated action",
        |fraction| 100.0 * fraction,
        1,
    ),
    degrees("command frame turned"),
    magnitude("lag", " control steps", f64::abs, 2),
    magnitude(
        "noise",
        " % of a demonstrated action",
        |fraction| 100.0 * fraction.abs(),
        1,
    ),
];

const fn degrees(name: &'static str) -> Told {
    signed(name, "°", |degrees| degrees, 1)
}

const fn centimetres(name: &'static str) -> Told {
    signed(name, " cm", |metres| 100.0 * metres, 1)
}

const fn signed(
    name: &'static str,
    unit: &'static str,
    convert: fn(f64) -> f64,
    decimals: usize,
) -> Told {
    Told {
        name,
        unit,
        convert,
        decimals,
        is_signed: true,
    }
}

const fn magnitude(
    name: &'static str,
    unit: &'static str,
    convert: fn(f64) -> f64,
    decimals: usize,
) -> Told {
    Told {
        is_signed: false,
        ..signed(name, unit, convert, decimals)
    }
}

impl Told {
    fn line(&self, value: f64) -> String {
        let value = (self.convert)(value);
        let decimals = self.decimals;
        let number = match self.is_signed {
            true => format!("{value:+.decimals$}"),
            false => format!("{value:.decimals$}"),
        };
        let number = number.replace('-', "−");
        let space = if self.name.ends_with('×') { "" } else { " " };
        format!("{}{space}{number}{}", self.name, self.unit)
    }
}

#[cfg(test)]
mod tests {
    use protocol::{CameraShift, Perturbation, SensorCorruption};

    use super::*;

    #[test]
    fn values_are_told_with_their_units_and_only_signs_that_count() {
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
