//! The lighting axis: brightness, colour, ambient term and elevation of a scene's lights. LIBERO's
//! lights cast no shadows, perturbed or not.

use benchmark::LightingShift;
use nalgebra::{Rotation3, Unit, Vector3};

/// Luminance of linear red, green and blue (ITU-R BT.709).
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];
/// Largest horizontal offset of a light that counts as straight above the look-at point, m.
const OVERHEAD_M: f64 = 1e-9;

/// One light of a scene, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    pub position: [f64; 3],
    /// Unit direction of the light's beam.
    pub direction: [f64; 3],
    pub diffuse: [f64; 3],
    pub specular: [f64; 3],
}

#[derive(Clone, Debug, PartialEq)]
pub struct Lighting {
    pub lights: Vec<Light>,
    pub headlight_ambient: [f64; 3],
}

/// Returns the perturbed lights. `look_at` is the nominal look-at point of the camera axis.
pub fn shift_lighting(nominal: &Lighting, look_at: [f64; 3], shift: &LightingShift) -> Lighting {
    let gain = shift.d_intensity_ev.exp2();
    let colour = colour(shift.d_log2_warm, shift.d_tint_g);
    let ambient_gain = shift.d_log2_ambient.exp2();
    let lights = nominal.lights.iter().map(|light| {
        let (position, direction) = elevate(light, look_at, shift.d_elevation_deg.to_radians());
        Light {
            position,
            direction,
            diffuse: std::array::from_fn(|i| light.diffuse[i] * gain * colour[i]),
            specular: light.specular.map(|channel| channel * gain),
        }
    });
    Lighting {
        lights: lights.collect(),
        headlight_ambient: nominal
            .headlight_ambient
            .map(|channel| (channel * ambient_gain).clamp(0.0, 1.0)),
    }
}

/// Returns colour factors of unit luminance: warmth and tint do not change a light's brightness.
fn colour(log2_warm: f64, log2_tint: f64) -> [f64; 3] {
    let half_tint = (-log2_tint / 2.0).exp2();
    let factors = [log2_warm.exp2() * half_tint, log2_tint.exp2(), (-log2_warm).exp2() * half_tint];
    let luminance: f64 = factors.iter().zip(LUMINANCE).map(|(f, l)| f * l).sum();
    factors.map(|factor| factor / luminance)
}

/// Rotates position and direction about the look-at point and the horizontal axis perpendicular to
/// the light's offset, by `angle` rad; a positive angle lowers the light.
fn elevate(light: &Light, look_at: [f64; 3], angle: f64) -> ([f64; 3], [f64; 3]) {
    let look_at = Vector3::from(look_at);
    let offset = Vector3::from(light.position) - look_at;
    let horizontal = offset.xy().norm();
    let axis = if horizontal > OVERHEAD_M {
        Vector3::new(-offset.y, offset.x, 0.0) / horizontal
    } else {
        Vector3::y()
    };
    let rotation = Rotation3::from_axis_angle(&Unit::new_unchecked(axis), angle);
    let position = rotation * offset + look_at;
    let direction = (rotation * Vector3::from(light.direction)).normalize();
    (position.into(), direction.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_has_unit_luminance() {
        let factors = colour(0.7, -0.3);
        let luminance: f64 = factors.iter().zip(LUMINANCE).map(|(f, l)| f * l).sum();
        assert!((luminance - 1.0).abs() < 1e-15);
        assert!(factors[0] > factors[2], "warm light has more red than blue");
    }

    #[test]
    fn an_overhead_light_turns_about_world_y() {
        let light = Light {
            position: [0.0, 0.0, 2.0],
            direction: [0.0, 0.0, -1.0],
            diffuse: [0.5; 3],
            specular: [0.2; 3],
        };
        let (position, direction) = elevate(&light, [0.0; 3], std::f64::consts::FRAC_PI_2);
        assert!((position[0] - 2.0).abs() < 1e-12, "{position:?}");
        assert!((direction[0] + 1.0).abs() < 1e-12, "{direction:?}");
    }
}
